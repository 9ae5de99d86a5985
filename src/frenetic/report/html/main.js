// Puts the page together.

const PAPER = 680; // px, what is printed on

function drawBar() {
  const links = report.sections.slice(1).map((section) => el("a", { href: `#${section.id}` }, section.title));
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
  document.getElementById("bar").append(el("a", { class: "brand", href: "#page" }, "Frenetic"), el("nav", { "aria-label": "Sections" }, links), theme);
}

function drawSection(section, place) {
  const body = el("div", { class: "blocks" });
  for (const block of section.blocks) {
    const element = el("div", { class: `block block-${block.kind}` });
    body.append(element);
    kinds[block.kind](element, block);
  }
  const title = el(place === 0 ? "h1" : "h2", { id: `${section.id}-title` }, section.title);
  return el("section", { id: section.id, "aria-labelledby": `${section.id}-title` }, title, section.lead ? el("p", { class: "lead" }, section.lead) : null, body);
}

document.documentElement.dataset.theme = storedTheme();
drawBar();
document.getElementById("page").append(...report.sections.map(drawSection));
document.getElementById("foot").append(`Made by ${report.made_by}. This file is complete: it loads nothing.`);

themeListeners.push(() => drawCharts());
window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => drawCharts());
// Plotly comes after this script, so that the page is there before it.
document.addEventListener("DOMContentLoaded", () => {
  drawCharts();
  openLinked();
});
// Paper is white, and narrower than most screens.
window.addEventListener("beforeprint", () => {
  document.documentElement.classList.add("printing");
  fitTrees(PAPER);
  drawCharts(PAPER - 40);
});
window.addEventListener("afterprint", () => {
  document.documentElement.classList.remove("printing");
  fitTrees(Infinity);
  drawCharts();
});
window.addEventListener("hashchange", openLinked);

/** Opens the test that the page's address names. */
function openLinked() {
  const match = location.hash.match(/^#test-(\d+)$/);
  if (match !== null) player.open(Number(match[1]));
}
