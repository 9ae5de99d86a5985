// A page that is one replay, within another page or alone.

document.documentElement.dataset.theme = storedTheme();
document.documentElement.classList.add("embedded");
player.open(report.replay, [report.replay]);

// The page around it may settle its width later.
let width = window.innerWidth;
window.addEventListener("resize", () => {
  if (window.innerWidth === width) return;
  width = window.innerWidth;
  player.open(report.replay, [report.replay]);
});
