// What draws a block: its kind -> a function of the element to fill and the block.

const kinds = {
  paragraph: (element, block) => void element.append(el("p", {}, block.text)),
  facts: drawFacts,
  command: (element, block) => void element.append(commandLine(block.line, block.text)),
  table: drawTable,
  picture: drawPicture,
  chart: drawChart,
  bars: drawBars,
  timeline: drawTimeline,
  gallery: drawGallery,
  elsewhere: drawElsewhere,
  featureMap: drawFeatureMap,
  family: drawFamily,
  headline: drawHeadline,
  groupTable: drawGroupTable,
  curves: drawCurves,
  spreads: drawSpreads,
  pairs: drawPairs,
};

function factList(facts) {
  return el("dl", { class: "facts" }, facts.map(({ name, value }) => el("div", {}, el("dt", {}, name), el("dd", {}, value))));
}

function drawFacts(element, block) {
  const list = factList(block.facts);
  if (block.folded) element.append(el("details", {}, el("summary", {}, block.title), list));
  else element.append(...(block.title ? [el("h3", {}, block.title)] : []), list);
}

function drawTable(element, block) {
  const style = (i) => (block.columns[i].is_number ? "number" : "");
  const head = el("tr", {}, block.columns.map((column, i) => el("th", { scope: "col", class: style(i), title: column.text || null }, column.title)));
  const linked = (text, address) => (address ? el("a", { href: address }, text) : text);
  const rows = block.rows.map((row, place) =>
    el("tr", { class: block.faint[place] ? "faint" : null }, row.map((text, i) => (i === 0 ? el("th", { scope: "row", class: style(i) }, linked(text, block.links[place])) : el("td", { class: style(i) }, text)))),
  );
  element.append(tableBox(block.columns.map((column) => column.title).join(", "), block.tall ? "tall" : "", head, rows));
  captioned(element, block.caption);
}

function drawPicture(element, block) {
  element.append(el("img", { class: "drawn", src: block.source, alt: block.text }));
  captioned(element, block.caption);
}

function drawHeadline(element, block) {
  const tiles = block.tiles.map((tile) =>
    el(
      "div",
      { class: tile.role ? `tile tile-${tile.role}` : "tile" },
      el("dt", {}, tile.label),
      el("dd", {}, el("b", {}, tile.value), tile.note ? el("span", { class: "quiet" }, tile.note) : null),
    ),
  );
  element.append(
    el("p", { class: "lead" }, block.lead),
    ...(block.warning ? [el("p", { class: "warning", role: "status" }, block.warning)] : []),
    el("dl", { class: "tiles" }, tiles),
    factList(block.facts),
  );
}
