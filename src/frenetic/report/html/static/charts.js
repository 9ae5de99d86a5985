// Charts: lines over a number and bars, drawn as SVG and elements that take the page's colours.

const EXPECTED = "if all roads were random";
const charts = []; // what is drawn again when the page's width changes
const DRAG = 6; // px, below it a drag is a click

/** Colours an element and what it holds by a name of the style sheet, such as "fail". */
function inColour(name, element) {
  element.style.setProperty("--series", `var(--${name})`);
  return element;
}

/** Round numbers from low to high, about so many; whole ones for what is counted. */
function roundTicks(low, high, number = 4, whole = false) {
  const rough = (high - low || 1) / number;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = Math.max(power * [1, 2, 5, 10].find((factor) => factor * power >= rough * (1 - 1e-9)), whole ? 1 : 0);
  const ticks = [];
  for (let i = Math.ceil(low / step - 1e-9); i * step <= high + 1e-9 * step; i++) ticks.push(i * step);
  return ticks;
}

/** The least and the most of numbers, of which some may be missing. */
function extent(numbers) {
  let [least, most] = [Infinity, -Infinity];
  for (const number of numbers) {
    if (number === null) continue;
    least = Math.min(least, number);
    most = Math.max(most, number);
  }
  return [least, most];
}

/** A number for an axis, without needless digits. */
function tickText(value) {
  return String(Number(value.toPrecision(6))).replace("-", "−");
}

/** The value of a line at a place; null where it has none. */
function valueAt(line, place) {
  const i = lastUpTo(line.x, place);
  if (i < 0 || (i === line.x.length - 1 && place > line.x[i])) return null;
  const [here, next] = [line.y[i], line.y[i + 1]];
  if (line.stepped || next === undefined || here === null || next === null) return here;
  return here + ((place - line.x[i]) / (line.x[i + 1] - line.x[i])) * (next - here);
}

/** SVG's text for a line; it is broken where a value is missing. */
function lineText(xs, ys, stepped) {
  let text = "";
  let isBroken = true;
  xs.forEach((x, i) => {
    const y = ys[i];
    if (y !== null) {
      const [u, v] = [x.toFixed(1), y.toFixed(1)];
      text += isBroken ? `M${u} ${v}` : stepped ? `H${u}V${v}` : `L${u} ${v}`;
    }
    isBroken = y === null;
  });
  return text;
}

/** A button that shows or hides what has a name: `hidden` holds the names that `redraw` leaves out. */
function legendButton(name, mark, hidden, redraw) {
  const button = el("button", { type: "button", "aria-pressed": "true", title: "Show or hide" }, mark, name);
  button.addEventListener("click", () => {
    if (!hidden.delete(name)) hidden.add(name);
    button.setAttribute("aria-pressed", String(!hidden.has(name)));
    redraw();
  });
  return button;
}

/**
 * A chart of lines that shows the values where one points and enlarges what one drags over.
 *
 * `figure` gives {lines, xTitle, yTitle, fromZero, wholeX, wholeY, testAt}; a line is
 * {name, x, y, low, high, role, width, dashed, stepped, digits, thin}, and `testAt` the test that a
 * click at a place opens.
 */
function chart(height, label, figure, { hasLegend = true } = {}) {
  const paper = svg("svg", { role: "img", "aria-label": label });
  const tip = el("div", { class: "chart-tip", role: "status", hidden: true });
  const drawing = el("div", { class: "chart-drawing", tabindex: 0, role: "group", "aria-label": `${label}; arrow keys read it` }, paper, tip);
  const legend = el("div", { class: "legend", role: "group", "aria-label": "Lines" });
  const whole = el("button", { type: "button", class: "whole", hidden: true, on: { click: () => zoom(null) } }, "Whole range");
  const place = el("div", { class: "chart" }, el("div", { class: "chart-head" }, hasLegend ? legend : null, whole), drawing);
  const hidden = new Set();
  let shown = null; // what is drawn: its lines, scales and cursor
  let range = null; // of x that is enlarged
  let pressed = null; // where a drag began

  function draw(width) {
    const found = figure();
    const tall = width ? Math.min(height, 260) : height;
    drawing.style.height = `${tall}px`;
    const lines = found.lines.filter((line) => !hidden.has(line.name));
    drawLegend(found.lines);
    shown = scales(found, lines, width ?? drawing.clientWidth, tall);
    fill(paper, { width: shown.width, height: shown.height, viewBox: `0 0 ${shown.width} ${shown.height}` }, []);
    paper.replaceChildren(...axes(shown), linesOf(shown));
    hide();
  }

  function drawLegend(lines) {
    const names = lines.map((line) => line.name).join("\n");
    if (legend.dataset.names === names) return;
    legend.dataset.names = names;
    const stroke = (line) => inColour(line.role, el("i", { class: line.dashed ? "stroke dashed" : "stroke", "aria-hidden": "true" }));
    legend.replaceChildren(...lines.map((line) => legendButton(line.name, stroke(line), hidden, () => draw())));
  }

  function scales(found, lines, width, tall) {
    const xs = extent(found.lines.flatMap((line) => line.x));
    const [first, last] = range ?? [found.fromZero ? 0 : xs[0], found.fromZero ? Math.max(xs[1], 1e-9) : xs[1]];
    const values = lines.flatMap((line) => {
      const [from, to] = range === null ? [0, line.x.length] : [Math.max(0, lastUpTo(line.x, first)), lastUpTo(line.x, last) + 2];
      return [line.y, line.low, line.high, ...(line.thin ?? [])].flatMap((ys) => ys.slice(from, to));
    });
    let [low, high] = extent(values);
    if (found.fromZero) [low, high] = [0, Math.max(high, found.wholeY ? 1 : 1e-9)];
    if (!Number.isFinite(low)) [low, high] = [0, 1];
    if (low === high) [low, high] = [low - 1, high + 1];
    const room = 0.05 * (high - low);
    [low, high] = [found.fromZero ? low : low - room, high + room];
    const yTicks = roundTicks(low, high, tall > 300 ? 5 : 4, found.wholeY);
    const left = 30 + 7.2 * Math.max(...yTicks.map((value) => tickText(value).length), 1);
    const [wide, up] = [Math.max(40, width - left - 16), tall - 54];
    return {
      found, lines, width, height: tall, left, wide, up, yTicks,
      xTicks: roundTicks(first, last, clamp(wide / 90, 2, 8), found.wholeX),
      x: (value) => ((value - first) / (last - first || 1)) * wide,
      y: (value) => up - ((value - low) / (high - low)) * up,
      at: (px) => first + clamp(px / wide, 0, 1) * (last - first),
      first, last,
    };
  }

  function axes({ found, left, wide, up, xTicks, yTicks, x, y }) {
    const top = 8;
    const text = (attributes, words) => svg("text", attributes, words);
    return [
      ...yTicks.map((value) => svg("path", { class: "grid", d: `M${left} ${top + y(value)}h${wide}` })),
      ...xTicks.map((value) => svg("path", { class: "grid", d: `M${left + x(value)} ${top}v${up}` })),
      ...yTicks.map((value) => text({ class: "y-tick", x: left - 8, y: top + y(value) + 4 }, tickText(value))),
      ...xTicks.map((value) => text({ class: "x-tick", x: left + x(value), y: top + up + 18 }, tickText(value))),
      text({ class: "x-title", x: left + wide / 2, y: top + up + 40 }, found.xTitle),
      text({ class: "y-title", transform: `translate(12 ${top + up / 2}) rotate(-90)` }, found.yTitle),
    ];
  }

  function linesOf({ lines, left, wide, up, x, y }) {
    // A drawing in the drawing cuts off what is out of range.
    const inner = svg("svg", { class: "lines", x: left - 3, y: 5, width: wide + 6, height: up + 6, viewBox: `-3 -3 ${wide + 6} ${up + 6}` });
    const places = (ys) => ys.map((value) => (value === null ? null : y(value)));
    for (const line of lines) {
      const xs = line.x.map(x);
      const group = inColour(line.role, svg("g", { class: "series", "data-name": line.name }));
      if (line.low.length) {
        const edge = lineText(xs, places(line.low), false);
        group.append(svg("path", { class: "band", d: `${edge}${lineText([...xs].reverse(), places(line.high).reverse(), false).replace("M", "L")}Z` }));
      }
      for (const ys of line.thin ?? []) group.append(svg("path", { class: "thin", d: lineText(xs, places(ys), false) }));
      group.append(svg("path", { class: line.dashed ? "line dashed" : "line", "stroke-width": line.width ?? 2, d: lineText(xs, places(line.y), line.stepped) }));
      inner.append(group);
    }
    inner.append(svg("rect", { class: "chosen", y: 0, height: up, width: 0, visibility: "hidden" }), svg("path", { class: "pointer", visibility: "hidden" }));
    return inner;
  }

  /** Where there are points: those of the line with most. */
  function pointed() {
    return shown.lines.reduce((most, line) => (line.x.length > most.length ? line.x : most), []);
  }

  /** Shows the values at a place, as near to one of the points as can be. */
  function point(value, isTouch = false) {
    const xs = pointed();
    if (!xs.length) return;
    const i = Math.max(0, lastUpTo(xs, value));
    const next = xs[i + 1];
    const here = next !== undefined && next - value < value - xs[i] ? next : xs[i];
    const px = shown.x(clamp(here, shown.first, shown.last));
    shown.cursor = here;
    shown.test = shown.found.testAt?.(here) ?? null;
    const pointer = paper.querySelector(".pointer");
    fill(pointer, { d: `M${px} 0V${shown.up}`, visibility: "visible" }, []);
    const rows = shown.lines.flatMap((line) => {
      const at = valueAt(line, here);
      if (at === null) return [];
      const text = Number.isInteger(at) ? tickText(at) : fixed(at, line.digits ?? 1);
      return [el("div", {}, inColour(line.role, el("i", { class: line.dashed ? "stroke dashed" : "stroke" })), el("span", {}, line.name), el("b", {}, text))];
    });
    const test = shown.test === null ? null : el("p", {}, `Latest failure: test ${shown.test}. `, el("span", { class: "quiet" }, isTouch ? "Tap again to open it." : "Click to open it."));
    const hint = isTouch || range !== null ? null : el("p", { class: "quiet" }, "Drag to enlarge a part.");
    const parts = [el("p", { class: "quiet" }, `${tickText(here)} ${shown.found.xTitle.split(",")[0]}`), ...rows, test, hint];
    tip.replaceChildren(...parts.filter((part) => part !== null));
    tip.hidden = false;
    drawing.classList.toggle("opens", test !== null);
    const room = shown.width - tip.offsetWidth - 4;
    const beside = px + shown.left > shown.width / 2 ? px + shown.left - tip.offsetWidth - 14 : px + shown.left + 14;
    tip.style.left = `${clamp(beside, 0, Math.max(0, room))}px`;
  }

  function hide() {
    tip.hidden = true;
    pressed = null;
    if (shown !== null) shown.cursor = null;
    for (const mark of paper.querySelectorAll(".pointer, .chosen")) mark.setAttribute("visibility", "hidden");
  }

  function zoom(to) {
    range = to;
    whole.hidden = to === null;
    draw();
  }

  /** Goes on by a hundredth of the points in sight, at least by one. */
  function walk(by) {
    const xs = pointed();
    const [low, high] = [Math.max(0, lastUpTo(xs, shown.first)), lastUpTo(xs, shown.last)];
    const at = shown.cursor === null ? low - by : lastUpTo(xs, shown.cursor);
    if (xs.length) point(xs[clamp(at + by * Math.ceil((high - low) / 100 || 1), low, high)]);
  }

  function openTest() {
    if (shown.test !== null && shown.test !== undefined) location.hash = `#test-${shown.test}`;
  }

  const across = (event) => event.clientX - paper.getBoundingClientRect().left - shown.left;
  drawing.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    drawing.setPointerCapture(event.pointerId); // a drag may leave the chart
    // The first touch shows the values, the second one there opens the test.
    const wasShown = !tip.hidden && shown.cursor !== null && Math.abs(shown.x(shown.cursor) - across(event)) < 24;
    pressed = { from: across(event), opens: event.pointerType !== "touch" || wasShown };
  });
  drawing.addEventListener("pointermove", (event) => {
    point(shown.at(across(event)), event.pointerType === "touch");
    if (pressed === null) return;
    const [low, high] = [pressed.from, across(event)].sort((a, b) => a - b).map((px) => clamp(px, 0, shown.wide));
    const isDrag = high - low > DRAG;
    fill(paper.querySelector(".chosen"), { x: low, width: high - low, visibility: isDrag ? "visible" : "hidden" }, []);
  });
  drawing.addEventListener("pointerup", (event) => {
    if (pressed === null) return;
    const { from, opens } = pressed;
    pressed = null;
    const [low, high] = [from, across(event)].sort((a, b) => a - b);
    if (high - low > DRAG) {
      if (shown.at(low) < shown.at(high)) zoom([low, high].map(shown.at));
    } else {
      point(shown.at(across(event)), !opens);
      if (opens) openTest();
    }
  });
  for (const left of ["pointerleave", "pointercancel", "blur"]) {
    drawing.addEventListener(left, (event) => { if (event.pointerType !== "touch" || left !== "pointerleave") hide(); });
  }
  drawing.addEventListener("keydown", (event) => {
    const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (step !== undefined) walk(step);
    else if (event.key === "Enter") openTest();
    else if (event.key === "Escape" && range !== null) zoom(null);
    else return;
    event.preventDefault();
  });

  const one = { place, draw, zoom };
  charts.push(one);
  let width = 0;
  new ResizeObserver(() => {
    const isPrinting = document.documentElement.classList.contains("printing"); // at a width of its own
    if (drawing.clientWidth === width || drawing.clientWidth === 0 || isPrinting) return;
    width = drawing.clientWidth;
    draw();
  }).observe(drawing);
  return one;
}

/** Draws all charts, for paper of so many pixels if that is given. */
function drawCharts(paper) {
  for (const one of charts) if (one.place.isConnected) one.draw(paper);
}

function captioned(element, text) {
  if (text) element.append(el("p", { class: "caption" }, text));
}

function drawChart(element, block) {
  const digits = 2;
  element.append(
    chart(320, `${block.y_title} over ${block.x_title}`, () => ({
      lines: block.series.map((line) => ({ ...line, digits })),
      xTitle: block.x_title, yTitle: block.y_title,
    })).place,
  );
  captioned(element, block.caption);
}

/** A bar for each name on a common scale, with its interval and its value. */
function drawBars(element, block) {
  const [least, most] = extent([0, 1e-9, ...block.values, ...block.low, ...block.high]);
  const ticks = roundTicks(least, most, 5);
  const [start, end] = [Math.min(least, ticks[0]), Math.max(most, ticks.at(-1))];
  const at = (value) => (100 * (value - start)) / (end - start);
  const digits = Math.max(1, 2 - Math.floor(Math.log10(Math.max(most, -least))));
  const placed = (style, ...ends) => {
    const mark = el("i", { class: style });
    const [from, to] = ends.sort((a, b) => a - b).map(at);
    mark.style.left = `${from}%`;
    mark.style.width = `${to - from}%`;
    return mark;
  };
  const rows = block.names.map((name, i) => {
    const [value, low, high] = [block.values[i], block.low[i] ?? null, block.high[i] ?? null];
    const track = inColour(block.role, el("div", { class: "bar-track" }));
    if (value !== null) track.append(placed("bar-fill", 0, value));
    if (low !== null && high !== null) track.append(placed("interval", low, high));
    const text = fixed(value, digits);
    const between = low === null || high === null ? "" : `, interval ${fixed(low, digits)} to ${fixed(high, digits)}`;
    return el(
      "div",
      { class: block.faint[i] ? "bar-row faint" : "bar-row", title: `${name}: ${text}${between}` },
      el("div", { class: "bar-name" }, el("b", {}, name), block.notes[i] ? el("span", { class: "quiet" }, block.notes[i]) : null),
      track,
      el("b", { class: "bar-value" }, text),
    );
  });
  const marks = ticks.map((value) => {
    const mark = el("span", {}, tickText(value));
    mark.style.left = `${at(value)}%`;
    return mark;
  });
  const axis = el("div", { class: "bar-row bar-axis" }, el("span", {}), el("div", { class: "bar-track" }, marks), el("span", {}));
  element.append(el("div", { class: "bars", role: "group", "aria-label": block.title }, rows, axis, el("p", { class: "bar-title quiet" }, block.title)));
  captioned(element, block.caption);
}

/** Failures over what was spent, with a choice of how to count that. */
function drawTimeline(element, block) {
  let axis = block.axes[0];
  const lines = () => {
    // Where no failure is like another, one line lies on the other.
    const isHidden = block.failures.every((number, i) => number === block.distinct[i]);
    const found = [];
    if (axis.expected !== null) {
      const { share, low, high, of, distinct, distinct_low, distinct_high } = axis.expected;
      const times = (factor) => of.map((roads) => roads * factor);
      found.push({ name: `failures ${EXPECTED}`, x: axis.x, y: times(share), low: times(low), high: times(high), role: "fail", dashed: true });
      found.push({ name: `distinct failures ${EXPECTED}`, x: axis.x, y: distinct, low: distinct_low, high: distinct_high, role: "accent", dashed: true });
    }
    found.push({ name: "failures", x: axis.x, y: block.failures, low: [], high: [], role: "fail", stepped: true, width: isHidden ? 6 : 2.4 });
    found.push({ name: "distinct failures", x: axis.x, y: block.distinct, low: [], high: [], role: "accent", stepped: true });
    return found;
  };
  const figure = chart(360, "Failures over simulations, tests or time", () => ({
    lines: lines(), xTitle: axis.title, yTitle: "found so far", fromZero: true, wholeX: axis.name !== "time", wholeY: true,
    testAt: (x) => block.latest[lastUpTo(axis.x, x)] ?? null,
  }));
  const names = block.axes.map((one) => one.name);
  const buttons = names.map((name) => el("button", { type: "button", "aria-pressed": String(name === axis.name) }, name === "time" ? "wall time" : name));
  buttons.forEach((button, i) =>
    button.addEventListener("click", () => {
      axis = block.axes[i];
      buttons.forEach((other) => other.setAttribute("aria-pressed", String(other === button)));
      figure.zoom(null);
    }),
  );
  element.append(el("div", { class: "choices" }, "Over ", el("div", { class: "switch", role: "group", "aria-label": "Over what" }, buttons)), figure.place);
  captioned(element, block.caption);
}
