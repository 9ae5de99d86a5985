// Failures in other simulators: both paths on each road.

const OTHER_COLOURS = ["ink", "group-2", "group-6", "group-3"];
const othersById = new Map(); // test -> its drives in other simulators, each with the simulator's name

function othersOf(id) {
  return othersById.get(id) ?? [];
}

/** Colours an element and what it holds as the drive in one of the other simulators. */
function asOther(i, element) {
  return tinted(OTHER_COLOURS[i % OTHER_COLOURS.length], element);
}

function drawElsewhere(element, block) {
  const there = block.drives.filter(({ test }) => drives.has(test)).map((other) => ({ ...other, name: block.there }));
  if (!there.length) return;
  for (const other of there) othersById.set(other.test, [...othersOf(other.test), other]);
  const order = there.map(({ test }) => test);
  const item = (other) => {
    const { test: id, agreement, moobd } = other;
    const [here, beyond] = [fixed(tests.get(id).moobd, 2, "m"), fixed(moobd, 2, "m")];
    const card = el(
      "button",
      { type: "button", class: "card", "data-test": id, "aria-label": `Test ${id}, ${agreement}, MOOBD ${here} here, ${beyond} there`, on: { click: () => player.open(id, order) } },
      roadPicture(drives.get(id), "", { others: [other] }),
      el("span", { class: "card-line" }, el("b", {}, `Test ${id}`)),
      el("span", { class: `verdict ${agreement.startsWith("fails") ? "outcome-fail" : ""}` }, agreement),
      el("span", { class: "card-text" }, `MOOBD ${here} here, ${beyond} there`),
    );
    return el("article", { class: "cluster" }, card);
  };
  const grid = el("div", { class: "gallery" });
  const more = el("button", { type: "button", class: "more", on: { click: () => fillGrid(grid, more, there, Infinity, item) } });
  fillGrid(grid, more, there, PAGE, item);
  arrowKeys(grid, () => [...grid.querySelectorAll(".card")]);
  element.append(
    grid,
    more,
    asOther(0, el("p", { class: "caption" }, "Solid: ", el("b", {}, block.here), ". ", el("i", { class: "stroke other" }), " Dashed: ", el("b", {}, block.there), ". A picture opens the test with both drives.")),
    el("p", { class: "caption" }, oobKey()),
  );
  if (block.drives.length > there.length) element.append(el("p", { class: "caption" }, `${count(block.drives.length - there.length, "drive")} more in the table only.`));
}

/** Who drove the dashed lines of the player, and to what end. */
function othersText(others) {
  return others.map(({ name, agreement, reason }, i) => asOther(i, el("p", { class: "quiet" }, el("i", { class: "stroke other" }), ` ${name}: ${agreement}. ${reason}`)));
}
