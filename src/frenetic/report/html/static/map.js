// The feature map: a grid of cells, coloured by what was found in them.

const SHADES = 7;
const CELL_PICTURES = 12;

function drawFeatureMap(element, block) {
  const pick = (id, chosen) =>
    el("select", { id }, block.axes.map((axis) => el("option", { value: axis.name, selected: axis.name === chosen }, axis.description)));
  const across = pick("map-across", block.first);
  const up = pick("map-up", block.second);
  const shade = el("select", { id: "map-shade" }, el("option", { value: "severity" }, "severity (lowest MOOBD)"), el("option", { value: "count" }, "number of failures"), el("option", { value: "share" }, "share that fails"));
  const place = el("div", { class: "map-place" });
  const panel = el("div", { class: "map-panel", "aria-live": "polite" });
  const axisOf = (select) => block.axes.find(({ name }) => name === select.value);

  const show = () => {
    panel.replaceChildren(el("p", { class: "quiet" }, "Choose a cell: click it, or move with the arrow keys and press Enter."));
    place.replaceChildren(mapGrid(block, axisOf(across), axisOf(up), shade.value, panel));
  };
  for (const select of [across, up, shade]) select.addEventListener("change", show);
  element.append(
    el("div", { class: "choices" }, labelled("Across ", across), labelled("Up ", up), labelled("Colour ", shade)),
    el("div", { class: "map" }, place, panel),
  );
  show();
}

/** Shows the map for two of its axes. */
function showAxes(first, second) {
  for (const [id, name] of [["map-across", first], ["map-up", second]]) {
    const select = document.getElementById(id);
    if (!select?.querySelector(`option[value="${name}"]`)) return;
    select.value = name;
    select.dispatchEvent(new Event("change"));
  }
  document.getElementById("map").scrollIntoView();
}

/** Number of cells; those of conditions have texts of their own. */
function cellCount(axis) {
  return axis.texts?.length ?? axis.edges.length - 1;
}

/** (cells) what was found, row by row from the top. */
function mapCells(block, xAxis, yAxis) {
  const [wide, tall] = [cellCount(xAxis), cellCount(yAxis)];
  const cells = Array.from({ length: wide * tall }, (_, i) => ({
    column: i % wide, row: tall - 1 - Math.floor(i / wide), failed: [], passed: [], worst: Infinity,
  }));
  block.tests.forEach((id, row) => {
    const test = tests.get(id);
    const [x, y] = [xAxis.bins[row], yAxis.bins[row]];
    if (x === "." || y === ".") return; // outside the domain
    const cell = cells[(tall - 1 - parseInt(y, 36)) * wide + parseInt(x, 36)];
    if (test.outcome === "FAIL") {
      cell.failed.push(test);
      cell.worst = Math.min(cell.worst, test.moobd ?? Infinity);
    } else cell.passed.push(test);
  });
  return cells;
}

function mapGrid(block, xAxis, yAxis, shade, panel) {
  const cells = mapCells(block, xAxis, yAxis);
  const [wide, tall] = [cellCount(xAxis), cellCount(yAxis)];
  const found = cells.filter((cell) => cell.failed.length);
  const worsts = found.map((cell) => cell.worst).filter(Number.isFinite);
  const [least, most] = [Math.min(...worsts), Math.max(...worsts)];
  const mostFailed = Math.max(1, ...found.map((cell) => cell.failed.length));
  const shadeOf = (cell) => {
    const byShade = {
      count: () => Math.log(cell.failed.length) / Math.max(Math.log(mostFailed), 1e-9),
      severity: () => (most > least && Number.isFinite(cell.worst) ? (most - cell.worst) / (most - least) : 1),
      share: () => failingShare(block, cell),
    };
    return clamp(Math.floor(byShade[shade]() * SHADES), 0, SHADES - 1);
  };
  const tint = shade === "count" ? "count" : "severity";
  const buttons = [];
  const grid = el("div", { class: "cells", role: "grid", "aria-label": `Feature map: ${xAxis.description} across, ${yAxis.description} up` });
  grid.style.gridTemplateRows = `repeat(${tall}, 1fr)`;
  for (let row = 0; row < tall; row++) {
    const line = el("div", { role: "row", class: "cell-row" });
    line.style.gridTemplateColumns = `repeat(${wide}, 1fr)`;
    for (const cell of cells.slice(row * wide, (row + 1) * wide)) {
      const driven = cell.failed.length + cell.passed.length;
      const depth = cell.failed.length ? shadeOf(cell) : null;
      const kind = depth !== null ? `${tint} depth-${depth}` : driven ? "covered" : "empty";
      const words = `${rangeText(xAxis, cell.column)}, ${rangeText(yAxis, cell.row)}: ${foundText(block, cell)}`;
      const button = el(
        "button",
        { type: "button", role: "gridcell", class: `cell ${kind}`, title: words, "aria-label": words, tabindex: -1 },
        cell.failed.length ? (shade === "share" ? `${fixed(100 * failingShare(block, cell), 0)}%` : String(cell.failed.length)) : "",
      );
      if (depth !== null) tinted(`${tint}-${depth}`, button);
      if (button.textContent.length >= 4) button.classList.add("long");
      const choose = () => {
        buttons.forEach((other) => other.setAttribute("aria-selected", String(other === button)));
        buttons.forEach((other) => (other.tabIndex = other === button ? 0 : -1));
      };
      button.addEventListener("click", () => {
        choose();
        showCell(block, panel, cell, xAxis, yAxis);
        scrollToPanel(panel);
      });
      buttons.push(button);
      line.append(button);
    }
    grid.append(line);
  }
  (buttons.find((button, i) => cells[i].failed.length) ?? buttons[0]).tabIndex = 0;
  arrowKeys(grid, () => buttons);
  const keyEnds = () => {
    if (shade === "count") return ["1 failure", String(mostFailed)];
    if (shade === "share") return [`${block.all_driven ? "share that fails" : "estimated share that fails"}: over ${percent(0)}`, percent(1)];
    return [`MOOBD ${oobWords(most)}`, oobWords(least)];
  };
  const covered = cells.filter((cell) => cell.failed.length || cell.passed.length).length;
  return el(
    "figure",
    { class: "map-figure" },
    el("div", { class: "map-y" }, axisTitle(yAxis)),
    edgeLabels(yAxis, true),
    grid,
    edgeLabels(xAxis, false),
    el("div", { class: "map-x" }, axisTitle(xAxis)),
    el(
      "figcaption",
      {},
      `Failures in ${block.all_failures ? "" : "at least "}${found.length} of ${cells.length} cells; ${block.all_driven ? "" : "at least "}${covered} were reached. `,
      ...(found.length ? [shadeKey(tint, keyEnds())] : []),
      el("span", { class: "key" }, el("i", { class: "covered" }), block.all_failures ? " driven without failure" : " no failure among those mapped"),
    ),
  );
}

/** Share of a cell's tests that fail, 0..1; where not all tests are in the map, each stands for several. */
function failingShare(block, { failed, passed }) {
  const failing = failed.length * block.weights.failed;
  return failing / Math.max(failing + passed.length * block.weights.passed, 1e-9);
}

/** What a cell holds; tests that are not in the map count only in the share. */
function foundText(block, cell) {
  const { failed, passed } = cell;
  const found = `${count(failed.length, "failure")} of ${count(failed.length + passed.length, block.all_driven ? "test" : "mapped test")}`;
  if (!failed.length) return found;
  return `${found}, ${block.all_driven ? "" : "about "}${percent(failingShare(block, cell))}`;
}

function shadeKey(shade, [first, last]) {
  const steps = Array.from({ length: SHADES }, (_, i) => tinted(`${shade}-${i}`, el("i", {})));
  return el("span", { class: "key" }, `${first} `, el("span", { class: "ramp" }, steps), ` ${last}`);
}

function axisTitle(axis) {
  return axis.unit ? `${axis.description} (${axis.unit})` : axis.description;
}

function edgeText(value) {
  return fixed(value, 5).replace(/\.?0+$/, "");
}

function rangeText(axis, bin) {
  if (axis.texts) return axis.texts[bin];
  if (axis.counts) return `${axis.description} ${countText(axis, bin)}`;
  return `${axis.description} ${edgeText(axis.edges[bin])} to ${edgeText(axis.edges[bin + 1])}${axis.unit ? ` ${axis.unit}` : ""}`;
}

/** The whole number in a cell of an axis that counts. */
function countText(axis, bin) {
  return String(axis.edges[bin] + 0.5);
}

/** Edges stand between cells, whole numbers at their middle. */
function edgeLabels(axis, isUp) {
  const cells = cellCount(axis);
  const texts = axis.ticks ?? (axis.counts ? axis.edges.slice(0, -1).map((_, i) => [i + 0.5, countText(axis, i)]) : axis.edges.map((edge, i) => [i, edgeText(edge)]));
  const labels = texts.map(([place, text], i) => {
    const label = el("span", { class: i % 2 && !axis.counts ? "odd" : "" }, text);
    label.style[isUp ? "bottom" : "left"] = `${(100 * place) / cells}%`;
    return label;
  });
  return el("div", { class: isUp ? "edges-y" : "edges-x", "aria-hidden": "true" }, labels);
}

function showCell(block, panel, cell, xAxis, yAxis) {
  const all = [...cell.failed].sort((a, b) => a.moobd - b.moobd).concat(cell.passed);
  const shown = all.filter((test) => drives.has(test.id));
  const pictures = shown.slice(0, CELL_PICTURES);
  const order = () => shown.map((test) => test.id);
  const others = all.filter((test) => !pictures.includes(test)).map((test) => `${test.id}${test.outcome === "FAIL" ? "" : " (pass)"}`);
  const parts = [
    el("h3", {}, foundText(block, cell)),
    el("p", { class: "quiet" }, `${rangeText(xAxis, cell.column)}; ${rangeText(yAxis, cell.row)}`),
    el("div", { class: "members" }, pictures.map((test) => card(test.id, order, { small: true }))),
  ];
  if (others.length) parts.push(el("p", { class: "quiet" }, `${pictures.length ? "Also tests" : "Tests"} ${others.slice(0, 40).join(", ")}${others.length > 40 ? `, and ${others.length - 40} more` : ""}.`));
  panel.replaceChildren(...parts);
}

/** Where the panel stands below the map, and not beside it, half of the screen shows it. */
function scrollToPanel(panel) {
  const { top } = panel.getBoundingClientRect();
  const isBelow = top >= panel.previousElementSibling.getBoundingClientRect().bottom;
  if (isBelow && top > window.innerHeight / 2) window.scrollBy({ top: top - window.innerHeight / 2 });
}
