// Charts: lines over a number, drawn by uPlot in the page's colours.

const charts = []; // what is drawn again when the page's colours or width change
const PAPER = 640; // px, what a chart is wide on paper

/** A colour of the style sheet as it is now, light or dark. */
function colourOf(name, share = 1) {
  const probe = el("i", {});
  probe.style.color = `var(--${name})`;
  document.body.append(probe);
  const { color } = getComputedStyle(probe);
  probe.remove();
  return share === 1 ? color : `color-mix(in srgb, ${color} ${100 * share}%, transparent)`;
}

/** A number for an axis or a line's value, without needless digits. */
function numberText(value) {
  return String(Number(value.toPrecision(4))).replace("-", "−");
}

/** The series of uPlot that draw a line: itself, the ends of its band, and thin lines beside it. */
function seriesOf(line, first) {
  const stepped = line.stepped ? { paths: uPlot.paths.stepped({ align: 1 }) } : {};
  const own = { label: line.name, stroke: () => colourOf(line.role), width: line.width, dash: line.dashed ? [7, 5] : [], points: { show: line.x.length < 2 }, ...stepped };
  const edge = { stroke: () => "transparent", width: 0, points: { show: false } };
  const thin = { stroke: () => colourOf(line.role, 0.4), width: 1, points: { show: false } };
  return {
    series: [own, ...(line.low.length ? [edge, edge] : []), ...line.singles.map(() => thin)],
    values: [line.y, ...(line.low.length ? [line.high, line.low] : []), ...line.singles],
    band: line.low.length ? { series: [first + 1, first + 2], fill: () => colourOf(line.role, 0.16) } : null,
  };
}

/**
 * A chart with buttons that hide its lines. It says the values where one points or walks with the
 * arrow keys, enlarges what one drags over, and opens the test that belongs to a place.
 */
function chart(block) {
  const label = `${block.y_title} over ${block.x_title}`;
  const tip = el("div", { class: "chart-tip", role: "status", hidden: true });
  const drawing = el("div", { class: "chart-drawing", tabindex: 0, role: "img", "aria-label": `${label}; arrow keys read it` }, tip);
  const whole = el("button", { type: "button", class: "whole", hidden: true }, "Whole range");
  const legend = el("div", { class: "legend", role: "group", "aria-label": "Lines" });
  const [series, tables, bands, own] = [[{}], [], [], []];
  for (const line of block.series) {
    own.push(series.length);
    const drawn = seriesOf(line, series.length);
    series.push(...drawn.series);
    tables.push([line.x, ...drawn.values]);
    if (drawn.band !== null) bands.push(drawn.band);
  }
  const data = uPlot.join(tables);
  const font = "12px system-ui, sans-serif"; // whole pixels: uPlot scales only those to dense screens
  const axis = (title, size) => ({ stroke: () => colourOf("quiet"), font, labelFont: font, label: title, labelSize: 18, size, grid: { stroke: () => colourOf("line"), width: 1 }, ticks: { show: false }, space: size > 30 ? 45 : 70, values: (_, values) => values.map(numberText) });
  const axes = [axis(block.x_title, 30), axis(block.y_title, 38)];
  if (block.counts) for (const one of axes) one.incrs = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 1e4, 2e4, 5e4, 1e5, 2e5, 5e5, 1e6];
  const plot = new uPlot(
    {
      width: 600, height: 340, series, bands, axes,
      legend: { show: false },
      cursor: { y: false, points: { size: 7 }, drag: { setScale: true } },
      scales: { x: { time: false, range: (_, low, high) => (low === high ? [low - 1, high + 1] : [low, high]) }, ...(block.counts ? { y: { range: (_, __, high) => [0, Math.max(1.03 * high, 1)] } } : {}) },
      hooks: { setCursor: [say], setScale: [() => (whole.hidden = isWhole())] },
    },
    data,
    drawing,
  );
  const [first, last] = [data[0][0], data[0].at(-1)];

  function isWhole() {
    const { min, max } = plot?.scales.x ?? {};
    return min === undefined || (min <= first && max >= last);
  }

  /** The test that belongs to a place. */
  function testAt(index) {
    const [line] = block.series;
    return block.tests[lastUpTo(line.x, data[0][index])] ?? null;
  }

  /** Says the values where the cursor is. */
  function say() {
    const { idx, left } = plot?.cursor ?? {};
    tip.hidden = idx === null || idx === undefined || left < 0;
    if (tip.hidden) return;
    const rows = block.series.flatMap((line, i) => {
      const i0 = lastUpTo(line.x, data[0][idx]);
      const value = i0 < 0 ? null : line.y[i0];
      if (value === null || !plot.series[own[i]].show) return [];
      return [el("div", {}, stroke(line), el("span", {}, line.name), el("b", {}, numberText(value)))];
    });
    const test = testAt(idx);
    drawing.classList.toggle("opens", test !== null);
    const parts = [el("p", { class: "quiet" }, `${numberText(data[0][idx])} ${block.x_title.split(",")[0]}`), ...rows];
    if (test !== null) parts.push(el("p", {}, `Latest failure: test ${test}. `, el("span", { class: "quiet" }, "Click to open it.")));
    tip.replaceChildren(...parts);
    const { offsetLeft, offsetWidth } = plot.over;
    const place = left > offsetWidth / 2 ? offsetLeft + left - tip.offsetWidth - 14 : offsetLeft + left + 14;
    tip.style.left = `${clamp(place, 0, Math.max(0, drawing.clientWidth - tip.offsetWidth))}px`;
  }

  function openTest(index) {
    const test = index === null || index === undefined ? null : testAt(index);
    if (test !== null) location.hash = `#test-${test}`;
  }

  function draw(width = drawing.clientWidth) {
    if (width > 0) plot.setSize({ width, height: width < 560 ? 260 : 340 });
  }

  let [pressed, tapped] = [0, null];
  plot.over.addEventListener("mousedown", (event) => (pressed = event.clientX));
  plot.over.addEventListener("click", (event) => {
    const { idx } = plot.cursor;
    if (Math.abs(event.clientX - pressed) >= 6) return;
    // A finger says the values first, and opens the test when it taps there again.
    if (event.pointerType === "touch" && tapped !== testAt(idx)) tapped = testAt(idx);
    else openTest(idx);
  });
  drawing.addEventListener("keydown", (event) => {
    const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    const at = plot.cursor.idx;
    if (step !== undefined) {
      const by = step * Math.ceil(data[0].length / 100);
      const next = clamp((at ?? (step > 0 ? -by : data[0].length)) + by, 0, data[0].length - 1);
      plot.setCursor({ left: plot.valToPos(data[0][next], "x"), top: 10 });
    } else if (event.key === "Enter") openTest(at);
    else return;
    event.preventDefault();
  });
  drawing.addEventListener("blur", () => plot.setCursor({ left: -10, top: -10 }));
  whole.addEventListener("click", () => plot.setScale("x", { min: first, max: last }));
  block.series.forEach((line, i) => {
    const button = el("button", { type: "button", "aria-pressed": "true", title: "Show or hide" }, stroke(line), line.name);
    button.addEventListener("click", () => {
      const show = button.getAttribute("aria-pressed") !== "true";
      button.setAttribute("aria-pressed", String(show));
      const next = own[i + 1] ?? series.length;
      for (let k = own[i]; k < next; k++) plot.setSeries(k, { show });
    });
    legend.append(button);
  });
  charts.push({ draw, plot });
  new ResizeObserver(() => {
    if (!document.documentElement.classList.contains("printing") && drawing.clientWidth !== plot.width) draw();
  }).observe(drawing);
  return el("div", { class: "chart" }, el("div", { class: "chart-head" }, legend, whole), drawing);
}

/** A line of the legend. */
function stroke(line) {
  return tinted(line.role, el("i", { class: line.dashed ? "stroke dashed" : "stroke", "aria-hidden": "true" }));
}

/** Draws all charts, for paper if it is wanted. */
function drawCharts(width) {
  for (const one of charts) {
    one.draw(width);
    one.plot.redraw(false);
  }
}

function drawChart(element, block) {
  element.append(chart(block));
  if (block.caption) element.append(el("p", { class: "caption" }, block.caption));
}
