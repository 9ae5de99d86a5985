// A table of all tests, which can be sorted and searched.

const ROWS = 50; // that are shown at first
const TEST_COLUMNS = [
  ["test", (test) => test.id, (test) => el("a", { href: `#test-${test.id}` }, String(test.id))],
  ["outcome", (test) => test.outcome, (test) => el("span", { class: `outcome-${test.outcome.toLowerCase()}` }, test.outcome)],
  [`MOOBD (m, at most ${fixed(report.lane_width / 2, 2)})`, (test) => test.moobd, (test) => fixed(test.moobd, 2)],
  ["side", (test) => test.side],
  ["criterion", (test) => test.criteria],
  ["road (m)", (test) => test.length, (test) => fixed(test.length, 0)],
  ["drive (s)", (test) => test.duration, (test) => fixed(test.duration, 1)],
];
const NUMBERS = [0, 2, 5, 6]; // columns of numbers

function drawTests(element) {
  let [sorted, isDown, shown] = [0, false, ROWS];
  const all = [...tests.values()];
  const pick = (id, values) => el("select", { id }, el("option", { value: "" }, "all"), values.map((value) => el("option", {}, value)));
  const outcome = pick("tests-outcome", [...new Set(all.map((test) => test.outcome))].sort());
  const search = el("input", { type: "search", id: "tests-search", placeholder: "number of a test", inputmode: "numeric" });
  const found = el("span", { role: "status", class: "found" });
  const head = el("tr", {});
  const body = el("tbody", {});
  const more = el("button", { type: "button", class: "more", on: { click: () => { shown *= 4; show(); } } });

  const show = () => {
    const number = search.value.trim().replace("#", "");
    const rows = all.filter(
      (test) =>
        (outcome.value === "" || test.outcome === outcome.value) &&
        (number === "" || String(test.id) === number),
    );
    const value = TEST_COLUMNS[sorted][1];
    const sign = isDown ? -1 : 1;
    rows.sort((a, b) => {
      const [one, other] = [value(a), value(b)];
      if (one === null || other === null) return (one === null) - (other === null); // unknown last
      return sign * (one > other ? 1 : one < other ? -1 : 0) || a.id - b.id;
    });
    const cell = (test, [, own, drawn], i) => el(i === 0 ? "th" : "td", { scope: i === 0 ? "row" : null, class: NUMBERS.includes(i) ? "number" : null }, drawn ? drawn(test) : own(test) ?? "–");
    body.replaceChildren(...rows.slice(0, shown).map((test) => el("tr", {}, TEST_COLUMNS.map((column, i) => cell(test, column, i)))));
    found.textContent = rows.length < all.length ? `${rows.length} of ${all.length}` : "";
    more.hidden = rows.length <= shown;
    more.textContent = `Show more of ${rows.length}`;
    head.replaceChildren(...TEST_COLUMNS.map(([title], i) => {
      const order = i !== sorted ? "none" : isDown ? "descending" : "ascending";
      const sort = () => { [sorted, isDown] = [i, i === sorted && !isDown]; show(); head.children[i].firstChild.focus(); };
      return el("th", { scope: "col", class: NUMBERS.includes(i) ? "number" : null, "aria-sort": order }, el("button", { type: "button", class: "sorts", on: { click: sort } }, title));
    }));
  };
  for (const field of [outcome, search]) field.addEventListener("input", () => { shown = ROWS; show(); });
  element.append(
    el("div", { class: "choices" }, labelled("Outcome ", outcome), labelled("Find ", search), found),
    scrollsSideways(el("div", { class: "table", tabindex: 0, role: "region", "aria-label": "All tests" }, el("table", {}, el("thead", {}, head), body))),
    more,
  );
  show();
}
