// Groups side by side: a table, curves, spreads, pairs.

const GROUP_COLOURS = 8;

function groupColour(group) {
  return `group-${group.colour % GROUP_COLOURS}`;
}

/** Whether a colour is used once more: then lines are dashed, and marks hollow. */
function isAgain(group) {
  return group.colour >= GROUP_COLOURS;
}

function coloured(group, element) {
  element.style.setProperty("--group", `var(--${groupColour(group)})`);
  return element;
}

function swatch(group) {
  return coloured(group, el("i", { class: isAgain(group) ? "swatch again" : "swatch", "aria-hidden": "true" }));
}

function groupName(group) {
  return el("span", { class: "group", title: group.name }, swatch(group), el("span", {}, group.name));
}

function drawGroupTable(element, block) {
  const arrows = { more: ["↑", "more is better"], less: ["↓", "less is better"] };
  const better = (column) => {
    const arrow = arrows[column.better];
    return arrow ? el("span", { class: "arrow", title: arrow[1], role: "img", "aria-label": arrow[1] }, `\u00a0${arrow[0]}`) : null;
  };
  // Neighbouring columns of one topic stand under its title.
  const begins = block.columns.map((column, i) => i === 0 || column.topic !== block.columns[i - 1].topic);
  const ends = (i) => block.columns.findIndex((_, k) => k > i && begins[k]);
  const span = (i) => (ends(i) < 0 ? block.columns.length : ends(i)) - i;
  const border = (i) => (begins[i] ? "begins" : "");
  const topics = el("tr", {}, el("td", {}), block.columns.flatMap((column, i) => (begins[i] ? [el("th", { scope: "colgroup", colspan: span(i), class: "topic begins" }, column.topic)] : [])));
  const head = el("tr", {}, el("th", { scope: "col" }, "group"), block.columns.map((column, i) => el("th", { scope: "col", class: `number ${border(i)}`, title: column.text || null }, column.title, better(column))));
  const cell = ({ value, note, strength }, i) => {
    const td = el("td", { class: `${border(i)} ${strength > 0 ? "strong" : ""}` }, el("b", {}, value), note ? el("span", { class: "quiet" }, note) : null);
    td.style.setProperty("--strength", strength);
    return td;
  };
  const rows = block.groups.map((group, i) => el("tr", {}, el("th", { scope: "row" }, groupName(group)), block.rows[i].map(cell)));
  element.classList.add("group-table");
  element.append(
    el("h3", {}, block.title),
    tableBox(block.title, "", [topics, head], rows),
  );
  captioned(element, block.caption);
}

/** Charts that share a legend, in which a group can be switched off. */
function drawCurves(element, block) {
  const hidden = new Set();
  const panels = block.panels.map((panel, i) =>
    chart(i === 0 ? 360 : 260, `${panel.title} over ${block.x_title}`, () => ({
      lines: panel.curves.filter((curve) => !hidden.has(curve.group.name)).map(groupLine),
      xTitle: block.x_title, yTitle: panel.title, fromZero: true, wholeX: true, wholeY: true,
    }), { hasLegend: false }),
  );
  const redraw = () => {
    for (const panel of panels) panel.draw();
  };
  const buttons = block.panels[0].curves.map(({ group }) => legendButton(group.name, swatch(group), hidden, redraw));
  element.append(el("div", { class: "legend", role: "group", "aria-label": "Groups" }, buttons), el("div", { class: "curve-panels" }, panels.map((panel) => el("div", {}, panel.place))));
  captioned(element, block.caption);
}

function groupLine({ group, x, median, low, high, singles }) {
  return { name: group.name, x, y: median, low, high, thin: singles, role: groupColour(group), dashed: isAgain(group), stepped: false };
}

/** Where values stand on a track, in percent; what is worse than any number has an end of its own. */
function spreadScale(panel) {
  const values = panel.spreads.flatMap((spread) => spread.values);
  const finite = values.filter((value) => value !== null);
  const hasNone = finite.length < values.length;
  let low = finite.length ? Math.min(...finite) : 0;
  let high = finite.length ? Math.max(...finite) : 1;
  // Of values that are all the same it is shown how far they are from zero.
  if (low === high) [low, high] = low === 0 ? [0, 1] : [Math.min(low, 0), Math.max(high, 0)];
  const [first, last] = hasNone ? (panel.none_is_low ? [14, 100] : [0, 86]) : [0, 100];
  const nowhere = panel.none_is_low ? 0 : 100;
  const at = (value) => (value === null ? nowhere : first + ((value - low) / (high - low)) * (last - first));
  const ticks = finite.length ? roundTicks(low, high).map((value) => [at(value), tickText(value)]).filter(([left]) => !hasNone || Math.abs(left - nowhere) > 20) : [];
  if (hasNone) ticks.push([nowhere, "none"]);
  return { at, ticks };
}

function drawSpreads(element, block) {
  const placed = (name, left) => {
    const found = el("i", { class: name });
    found.style.left = `${left}%`;
    return found;
  };
  const row = (spread, at) => {
    const track = coloured(spread.group, el("div", { class: "track", title: spread.texts.join(", ") }, el("i", { class: "base" })));
    if (spread.quartiles !== null) {
      const [low, median, high] = spread.quartiles.map(at);
      const box = placed("box", Math.min(low, high));
      box.style.width = `${Math.abs(high - low)}%`;
      track.append(box, placed("median", median));
    }
    spread.values.forEach((value, i) => {
      const dot = placed("dot", at(value));
      // Side by side where they would hide each other.
      dot.style.top = `${spread.values.length === 1 ? 50 : [50, 28, 72][i % 3]}%`;
      track.append(dot);
    });
    return el("div", { class: "spread" }, groupName(spread.group), track, el("b", {}, spread.median));
  };
  const panels = block.panels.map((panel) => {
    const { at, ticks } = spreadScale(panel);
    const marks = ticks.map(([left, text]) => {
      const mark = el("span", {}, text);
      mark.style.left = `${left}%`;
      return mark;
    });
    const axis = el("div", { class: "spread spread-axis", "aria-hidden": "true" }, el("span", {}), el("div", { class: "track" }, marks), el("span", {}));
    return el("div", { class: "spread-panel" }, el("h3", {}, panel.title), el("p", { class: "quiet" }, panel.note), panel.spreads.map((spread) => row(spread, at)), axis);
  });
  element.append(el("div", { class: "spread-panels" }, panels));
  captioned(element, block.caption);
}

function drawPairs(element, block) {
  const place = el("div", {});
  const odds = (pair) => {
    const bar = el("i", { class: pair.better ? "shown" : null });
    bar.style.left = `${100 * Math.min(pair.a12, 0.5)}%`;
    bar.style.width = `${100 * Math.abs(pair.a12 - 0.5)}%`;
    return coloured(pair.a12 >= 0.5 ? pair.first : pair.second, el("span", { class: "odds-track", "aria-hidden": "true" }, bar));
  };
  const draw = (by) => {
    const head = ["first", "second", "A12", "effect", "p", "p corrected", "what can be said"];
    const number = (i) => (i >= 4 && i <= 5 ? "number" : null);
    const rows = by.pairs.map((pair) =>
      el(
        "tr",
        {},
        el("td", { class: pair.better === 1 ? "is-better" : null }, groupName(pair.first)),
        el("td", { class: pair.better === 2 ? "is-better" : null }, groupName(pair.second)),
        el("td", { class: "odds" }, fixed(pair.a12, 2), odds(pair)),
        el("td", {}, pair.effect),
        el("td", { class: "number" }, pair.p),
        el("td", { class: "number" }, pair.p_corrected),
        el("td", {}, pair.verdict),
      ),
    );
    place.replaceChildren(
      tableBox(`Pairs by ${by.title}`, "pairs-table", el("tr", {}, head.map((text, i) => el("th", { scope: "col", class: number(i) }, text))), rows),
      el("p", { class: "caption" }, `By ${by.title}: ${by.note}. ${block.caption}`),
    );
  };
  const select = el("select", { id: "pairs-by" }, block.measures.map((by, i) => el("option", { value: i }, by.title)));
  select.addEventListener("change", () => draw(block.measures[Number(select.value)]));
  element.append(el("div", { class: "choices" }, el("span", {}, el("label", { for: "pairs-by" }, "By"), select)), place);
  draw(block.measures[0]);
}
