// A page that grows: it asks its server for the campaign's state, and for what is new in the report.

const PATIENCE = 5; // times the interval, between two questions when little is to be expected

const strip = el("aside", { id: "live", "aria-label": "The campaign now" });
const sign = el("a", { class: "live-badge", href: "#page", role: "status" });
let edition = "";

async function ask(path) {
  const answer = await fetch(path, { cache: "no-store" });
  if (!answer.ok) throw new Error(`${answer.status} ${path}`);
  return answer.json();
}

async function follow() {
  let wait = report.interval;
  if (!document.hidden) {
    let [state, news] = [null, null];
    try {
      state = await ask("state");
      if (state.edition !== edition) news = await ask(`news?${edition}`);
    } catch {
      state = null;
    }
    showState(state);
    if (news !== null) grow(news);
    if (state === null || (state.has_ended && state.edition === edition)) wait *= PATIENCE;
  }
  setTimeout(follow, 1000 * wait);
}

function showState(state) {
  const { status, note, progress, budget_spent: spent, workers, messages } = state ?? {
    status: "not connected",
    note: "The page is not served any more, so it does not grow; what is here stays. 'frenetic watch --serve' shows the campaign again.",
    progress: "", budget_spent: 0, workers: "", messages: [],
  };
  const kind = status.replace(" ", "-");
  const share = percent(spent);
  for (const one of [strip, sign]) one.dataset.status = kind;
  const words = progress ? `${status} ${share}` : status;
  if (sign.textContent !== words) sign.replaceChildren(el("i", { "aria-hidden": "true" }), words);
  const bar = el("i", { class: "live-spent" });
  bar.style.width = `${100 * spent}%`;
  strip.replaceChildren(
    el("p", {}, el("b", {}, status), progress ? ` ${progress}` : "", workers ? `; workers: ${workers}` : ""),
    ...(note ? [el("p", { class: "quiet" }, note)] : []),
    ...messages.map((text) => el("p", { class: "live-message" }, text)),
    ...(progress ? [el("div", { class: "live-budget", "aria-hidden": "true" }, bar)] : []),
  );
}

/** Takes over what is new in the report, without disturbing who reads it. */
function grow(news) {
  const isFirst = edition === "";
  edition = news.edition;
  if (news.whole) for (const known of [tests, drives, repeatsById, othersById, traits]) known.clear();
  Object.assign(report, news.head);
  if (news.tests !== null) readTests(news.tests);
  for (const drive of news.drives) drives.set(drive.id, drive);
  const changed = new Map(news.sections.map((section) => [section.id, section]));
  report.sections = news.order.map((id) => changed.get(id) ?? report.sections.find((section) => section.id === id));
  keepingPlace(() => {
    for (const [id, { element }] of drawn) {
      if (news.order.includes(id)) continue;
      element.remove();
      drawn.delete(id);
    }
    report.sections.forEach((section, place) => changed.has(section.id) && renewSection(section, place));
  });
  document.title = report.title;
  drawLinks();
  if (isFirst) openLinked();
}

function renewSection(section, place) {
  const partsOf = (one) => [Boolean(one.lead), ...one.blocks.map((block) => block.kind)].join();
  const old = drawn.get(section.id);
  if (old === undefined || partsOf(old.section) !== partsOf(section)) {
    const element = drawSection(section, place);
    if (old !== undefined) old.element.replaceWith(element);
    else main.insertBefore(element, main.querySelectorAll(":scope > section")[place] ?? null);
    return;
  }
  const before = old.section;
  old.section = section;
  old.title.textContent = section.title;
  if (old.lead !== null) old.lead.textContent = section.lead;
  section.blocks.forEach((block, i) => {
    if (JSON.stringify(block) === JSON.stringify(before.blocks[i])) return;
    const element = old.elements[i];
    if (typeof old.renew[i] === "function") old.renew[i](block);
    else {
      const across = [...element.querySelectorAll(".goes-on, .table")].map((box) => box.scrollLeft);
      element.replaceChildren();
      old.renew[i] = kinds[block.kind](element, block);
      element.querySelectorAll(".goes-on, .table").forEach((box, k) => (box.scrollLeft = across[k] ?? 0));
    }
  });
}

/** Changes the page, while what is read stays where it is on the screen, and the focus where it was. */
function keepingPlace(change) {
  const nameOf = (element) => {
    const part = element?.closest?.("[data-test], [data-cell], [id]");
    if (!part) return "";
    const name = ["data-test", "data-cell", "id"].find((one) => part.hasAttribute(one));
    const section = part.parentElement.closest("section");
    return `${section ? `#${section.id} ` : ""}[${name}="${CSS.escape(part.getAttribute(name))}"]`;
  };
  const focus = document.activeElement;
  const focused = main.contains(focus) ? nameOf(focus) : "";
  const edge = document.getElementById("bar").getBoundingClientRect().bottom;
  const inSight = (one) => one.getBoundingClientRect().bottom > edge && one.offsetParent !== null;
  // A headline in the upper part of the screen begins what is read; else its first picture or block.
  const begins = (one) => inSight(one) && one.getBoundingClientRect().top < 0.6 * window.innerHeight;
  const anchor = window.scrollY === 0 ? null : [...main.querySelectorAll("h1, h2")].findLast(begins) ?? [...main.querySelectorAll(".card, .block")].find(inSight) ?? null;
  const [name, top] = [nameOf(anchor), anchor?.getBoundingClientRect().top];
  change();
  const there = anchor?.isConnected ? anchor : name ? document.querySelector(name) : null;
  if (there) window.scrollBy({ top: there.getBoundingClientRect().top - top, behavior: "instant" });
  if (focused && document.activeElement !== focus) {
    const again = focus.isConnected ? focus : document.querySelector(focused);
    if (again) {
      again.tabIndex = 0;
      again.focus({ preventScroll: true });
    }
  }
}

document.documentElement.style.overflowAnchor = "none"; // `keepingPlace` does it
document.getElementById("theme").before(sign);
main.before(strip);
follow();
document.addEventListener("visibilitychange", () => document.hidden || ask("state").then(showState, () => showState(null)));
