// Puts the page together.

const kinds = {
  chart: drawChart,
  gallery: drawGallery,
  featureMap: drawFeatureMap,
  tests: drawTests,
};

function drawTheme() {
  const select = document.getElementById("theme");
  select.value = document.documentElement.dataset.theme;
  select.addEventListener("change", () => {
    setTheme(select.value);
    drawCharts();
  });
}

document.documentElement.dataset.theme = storedTheme();
drawTheme();
document.querySelectorAll("#bar nav, main .table").forEach(scrollsSideways);
document.querySelectorAll(".command-line").forEach(makeCopied);
for (const element of document.querySelectorAll("[data-block]")) {
  const block = report.blocks[element.dataset.block];
  kinds[block.kind](element, block);
}

document.addEventListener("DOMContentLoaded", openLinked);
window.addEventListener("hashchange", openLinked);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => drawCharts());
// Paper is white, narrower than most screens, and nothing on it can be unfolded.
let unfolded = [];
window.addEventListener("beforeprint", () => {
  document.documentElement.classList.add("printing");
  unfolded = [...document.querySelectorAll("main details:not([open])")];
  for (const details of unfolded) details.open = true;
  drawCharts(PAPER);
});
window.addEventListener("afterprint", () => {
  document.documentElement.classList.remove("printing");
  for (const details of unfolded) details.open = false;
  drawCharts();
});

/** Opens the test or the pair of axes that the page's address names, or says that it is not there. */
function openLinked() {
  document.getElementById("notice")?.remove();
  const axes = location.hash.match(/^#map:(\w+):(\w+)$/);
  if (axes !== null) showAxes(axes[1], axes[2]);
  const match = location.hash.match(/^#test-(\d+)$/);
  if (match === null) return;
  const id = Number(match[1]);
  if (drives.has(id)) player.open(id);
  else if (report.campaign) document.body.append(absence(id));
}

function absence(id) {
  const words = `The drive of test ${id} is not in this report. ${tests.has(id) ? "This" : "If the campaign has this test, this"} shows it:`;
  const notice = el(
    "aside",
    { id: "notice", role: "status" },
    commandLine(`frenetic show ${report.campaign} ${id}`, words),
    el("button", { type: "button", class: "close", on: { click: () => { notice.remove(); setFragment(""); } } }, "Close"),
  );
  return notice;
}
