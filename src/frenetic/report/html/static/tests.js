// A table of all tests, which can be sorted and searched.

const ROWS = 50; // that are shown at first

function numberColumn(name, title, digits) {
  return { name, title, isNumber: true, draw: (test) => fixed(test[name], digits) };
}

/** An amount of a condition, with as many digits as tell it apart from others. */
function amount(value) {
  return value === null ? "–" : String(Number(value.toPrecision(3))).replace("-", "−");
}

// Columns in which no test has a value, or all have the usual one, are left out.
const TEST_COLUMNS = [
  { name: "id", title: "test", isNumber: true, draw: (test) => el("a", { href: `#test-${test.id}` }, String(test.id)) },
  { name: "outcome", title: "outcome", draw: (test) => el("span", { class: `outcome-${test.outcome.toLowerCase()}` }, test.outcome) },
  numberColumn("moobd", `MOOBD (m, at most ${fixed((report.lane_width ?? 4) / 2, 2)})`, 2),
  { name: "side", title: "side" },
  { name: "criteria", title: "criterion", usual: "lane" },
  { name: "cause", title: "the driver", isText: true },
  { name: "certainty", title: "how sure" },
  numberColumn("distinct", "distinct", 0),
  numberColumn("length", "road (m)", 0),
  numberColumn("minimised", "cut to (m)", 0),
  numberColumn("duration", "drive (s)", 1),
  ...(report.conditions ?? []).map(({ column, title }) => ({ name: column, title, isNumber: true, draw: (test) => amount(test[column]) })),
].filter((column) => (report.tests?.[column.name] ?? []).some((value) => value !== null && value !== column.usual));

function drawTests(element) {
  let [sorted, isDown, shown] = [0, false, ROWS];
  const all = [...tests.values()];
  const pick = (id, values) => el("select", { id }, el("option", { value: "" }, "all"), values.map((value) => el("option", {}, value)));
  const outcome = pick("tests-outcome", [...new Set(all.map((test) => test.outcome))].sort());
  const causes = [...new Set(all.map((test) => test.cause ?? null))].filter((text) => text !== null).sort();
  const cause = pick("tests-cause", causes);
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
        (cause.value === "" || test.cause === cause.value) &&
        (number === "" || String(test.id) === number),
    );
    const { name } = TEST_COLUMNS[sorted];
    const sign = isDown ? -1 : 1;
    rows.sort((a, b) => {
      const [one, other] = [a[name], b[name]];
      if (one === null || other === null) return (one === null) - (other === null); // unknown last
      return sign * (one > other ? 1 : one < other ? -1 : 0) || a.id - b.id;
    });
    const cell = (test, column, i) => el(i === 0 ? "th" : "td", { scope: i === 0 ? "row" : null, class: column.isNumber ? "number" : column.isText ? "words" : null }, column.draw ? column.draw(test) : test[column.name] ?? "–");
    body.replaceChildren(...rows.slice(0, shown).map((test) => el("tr", {}, TEST_COLUMNS.map((column, i) => cell(test, column, i)))));
    found.textContent = rows.length < all.length ? `${rows.length} of ${all.length}` : "";
    more.hidden = rows.length <= shown;
    more.textContent = `Show more of ${rows.length}`;
    head.replaceChildren(...TEST_COLUMNS.map(({ title, isNumber }, i) => {
      const order = i !== sorted ? "none" : isDown ? "descending" : "ascending";
      const sort = () => { [sorted, isDown] = [i, i === sorted && !isDown]; show(); head.children[i].firstChild.focus(); };
      return el("th", { scope: "col", class: isNumber ? "number" : null, "aria-sort": order }, el("button", { type: "button", class: "sorts", on: { click: sort } }, title));
    }));
  };
  for (const field of [outcome, cause, search]) field.addEventListener("input", () => { shown = ROWS; show(); });
  element.append(
    el("div", { class: "choices" }, labelled("Outcome ", outcome), causes.length > 1 ? labelled("Cause ", cause) : null, labelled("Find ", search), found),
    scrollsSideways(el("div", { class: "table", tabindex: 0, role: "region", "aria-label": "All tests" }, el("table", {}, el("thead", {}, head), body))),
    more,
  );
  show();
}
