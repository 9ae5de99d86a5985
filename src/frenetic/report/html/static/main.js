// Puts the page together.

const PAPER = 680; // px, what is printed on

const main = document.getElementById("page");
const links = report.sections.slice(1).map((section) => el("a", { href: `#${section.id}` }, section.title));
const nav = scrollsSideways(el("nav", { "aria-label": "Sections" }, links));

function drawBar() {
  const theme = el("button", { type: "button", id: "theme", class: "theme" });
  const say = () => {
    const now = document.documentElement.dataset.theme;
    theme.textContent = { auto: "Auto", light: "Light", dark: "Dark" }[now];
    theme.setAttribute("aria-label", `Colours: ${now}; change`);
  };
  theme.addEventListener("click", () => {
    setTheme(THEMES[(THEMES.indexOf(document.documentElement.dataset.theme) + 1) % THEMES.length]);
    say();
  });
  say();
  document.getElementById("bar").append(el("a", { class: "brand", href: "#page" }, "Frenetic"), nav, theme);
}

function drawSection(section, place) {
  const elements = section.blocks.map((block) => el("div", { class: `block block-${block.kind}` }));
  const body = el("div", { class: "blocks" }, elements);
  section.blocks.forEach((block, i) => kinds[block.kind](elements[i], block));
  const title = el(place === 0 ? "h1" : "h2", { id: `${section.id}-title` }, section.title);
  const lead = section.lead ? el("p", { class: "lead" }, section.lead) : null;
  return el("section", { id: section.id, "aria-labelledby": `${section.id}-title` }, title, lead, body);
}

document.documentElement.dataset.theme = storedTheme();
drawBar();
main.append(...report.sections.map(drawSection));
document.getElementById("foot").append(`Made by ${report.made_by}. This file is complete: it loads nothing.`);

document.addEventListener("DOMContentLoaded", openLinked);
// Paper is white, narrower than most screens, and nothing on it can be unfolded.
let unfolded = [];
window.addEventListener("beforeprint", () => {
  document.documentElement.classList.add("printing");
  unfolded = [...document.querySelectorAll("main details:not([open])")];
  for (const details of unfolded) details.open = true;
  fitTrees(PAPER);
  drawCharts(PAPER - 40);
});
window.addEventListener("afterprint", () => {
  document.documentElement.classList.remove("printing");
  for (const details of unfolded) details.open = false;
  fitTrees(Infinity);
  drawCharts();
});
window.addEventListener("hashchange", openLinked);

/** Opens the test that the page's address names, or says that it is not there. */
function openLinked() {
  document.getElementById("notice")?.remove();
  const match = location.hash.match(/^#test-(\d+)$/);
  if (match === null) return;
  const id = Number(match[1]);
  if (drives.has(id)) player.open(id);
  else if (report.campaign) document.body.append(absence(id));
}

function absence(id) {
  const notice = el(
    "aside",
    { id: "notice", role: "status" },
    commandLine(`frenetic show ${report.campaign} ${id}`, `The drive of test ${id} is not in this report. If the campaign has this test, this shows it:`),
    el("button", { type: "button", class: "close", on: { click: () => { notice.remove(); setFragment(""); } } }, "Close"),
  );
  return notice;
}
