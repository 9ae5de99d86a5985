// Charts, drawn with Plotly in the page's own colours.

const EXPECTED = "failures if all roads were random";
const charts = []; // what is drawn again when the colours or the page's width change

/** Runs Plotly, which waits in the page as a text: it takes its time, and not every page has charts. */
function startPlotly() {
  if (!window.Plotly) document.body.append(el("script", {}, document.getElementById("plotly").textContent));
}

/** A chart that is drawn soon; `figure` gives its traces and layout. */
function chart(height, label, figure) {
  const place = el("div", { class: "chart", role: "img", "aria-label": label });
  const draw = (paper) => {
    startPlotly();
    one.isDrawn = true;
    const { traces, layout } = figure();
    const tall = paper ? Math.min(height, 260) : height;
    place.style.height = `${tall}px`;
    Plotly.react(place, traces, chartLayout({ ...layout, height: tall, ...(paper ? { width: paper } : {}) }), { displayModeBar: false, responsive: !paper });
  };
  place.style.height = `${height}px`;
  const one = { place, draw, isDrawn: false };
  charts.push(one);
  return place;
}

/** Draws all charts, for paper of so many pixels if that is given. */
function drawCharts(paper) {
  for (const one of charts) if (one.place.isConnected) one.draw(paper);
}

/** Draws those charts that are not there yet, one after the other: the page can be used meanwhile. */
function drawChartsSoon() {
  const next = charts.find((one) => !one.isDrawn && one.place.isConnected);
  if (next === undefined) return;
  next.draw();
  setTimeout(drawChartsSoon);
}

/** Ticks at whole numbers for an axis that counts up to so many. */
function wholeTicks(most) {
  return most <= 6 ? { tick0: 0, dtick: 1 } : {};
}

function chartLayout({ xaxis, yaxis, ...rest }) {
  const [ink, quiet, line, panel] = ["ink", "quiet", "line", "panel"].map((name) => colour(name));
  const axis = { gridcolor: line, zerolinecolor: line, linecolor: line, tickcolor: line, fixedrange: true, automargin: true, title: { standoff: 10 } };
  const merged = (own) => ({ ...axis, ...own, title: { ...axis.title, text: own.title, font: { color: quiet, size: 12 } }, tickfont: { color: quiet, size: 11 } });
  return {
    paper_bgcolor: "rgba(0,0,0,0)",
    plot_bgcolor: "rgba(0,0,0,0)",
    font: { family: getComputedStyle(document.body).fontFamily, color: ink, size: 12 },
    margin: { l: 44, r: 12, t: 8, b: 40 },
    hoverlabel: { bgcolor: panel, bordercolor: line, font: { color: ink } },
    legend: { orientation: "h", x: 0, y: 1.02, yanchor: "bottom", font: { color: ink } },
    dragmode: false,
    ...rest,
    xaxis: merged(xaxis),
    yaxis: merged(yaxis),
  };
}

/** A line, with its band before it. */
function lineTraces(series) {
  const shared = { x: series.x, mode: "lines", type: "scatter", line: { shape: series.stepped ? "hv" : "linear" } };
  const traces = [];
  if (series.low.length) {
    const band = { ...shared, hoverinfo: "skip", showlegend: false, line: { width: 0, color: colour(series.role) } };
    traces.push({ ...band, y: series.low }, { ...band, y: series.high, fill: "tonexty", fillcolor: colour(series.role, 0.16) });
  }
  traces.push({ ...shared, y: series.y, name: series.name, line: { ...shared.line, width: series.width ?? 2, color: colour(series.role), dash: series.dashed ? "dash" : "solid" } });
  return traces;
}

function captioned(element, text) {
  if (text) element.append(el("p", { class: "caption" }, text));
}

function drawChart(element, block) {
  element.append(
    chart(320, `${block.y_title} over ${block.x_title}`, () => ({
      traces: block.series.flatMap(lineTraces),
      layout: { hovermode: "x unified", xaxis: { title: block.x_title }, yaxis: { title: block.y_title } },
    })),
  );
  captioned(element, block.caption);
}

function drawBars(element, block) {
  const intervals = () => (block.low.length ? { error_x: { type: "data", symmetric: false, array: block.high.map((high, i) => high - block.values[i]), arrayminus: block.low.map((low, i) => block.values[i] - low), color: colour("quiet"), thickness: 1.2, width: 4 } } : {});
  const figure = () => ({
    traces: [{ type: "bar", orientation: "h", y: block.names, x: block.values, marker: { color: opaque(block.role, 0.6) }, hovertemplate: "%{y}: %{x:.1f}<extra></extra>", ...intervals() }],
    layout: { bargap: 0.4, xaxis: { title: block.title, rangemode: "tozero" }, yaxis: { title: "", autorange: "reversed", type: "category", gridcolor: "rgba(0,0,0,0)" } },
  });
  element.append(chart(Math.max(140, 26 * block.names.length + 64), block.title, figure));
  captioned(element, block.caption);
}

/** Failures over what was spent, with a choice of how to count that. */
function drawTimeline(element, block) {
  let axis = block.axes[0];
  // Where no failure is like another, one line lies on the other.
  const isHidden = block.failures.every((number, i) => number === block.distinct[i]);
  const series = () => {
    const found = [];
    if (axis.expected !== null) {
      const { share, low, high, of } = axis.expected;
      const times = (factor) => of.map((roads) => roads * factor);
      found.push({ name: EXPECTED, x: axis.x, y: times(share), low: times(low), high: times(high), role: "quiet", dashed: true });
    }
    found.push({ name: "failures", x: axis.x, y: block.failures, low: [], high: [], role: "fail", stepped: true, width: isHidden ? 6 : 2.4 });
    found.push({ name: "distinct failures", x: axis.x, y: block.distinct, low: [], high: [], role: "accent", stepped: true });
    return found;
  };
  const most = (lines) => Math.max(...lines.map((line) => Math.max(line.y.at(-1), line.high.at(-1) ?? 0)));
  const place = chart(360, "Failures over simulations, tests or time", () => ({
    traces: series().flatMap(lineTraces).map((trace) => ({ ...trace, cliponaxis: false, hovertemplate: trace.name === EXPECTED ? "%{y:.1f}" : "%{y}" })),
    layout: { hovermode: "x unified", xaxis: { title: axis.title, rangemode: "tozero", ...(axis.name === "time" ? {} : wholeTicks(axis.x.at(-1))) }, yaxis: { title: "found so far", rangemode: "tozero", ...wholeTicks(most(series())) } },
  }));
  const buttons = block.axes.map((one) =>
    el("button", { type: "button", "aria-pressed": String(one === axis) }, one.name === "time" ? "wall time" : one.name),
  );
  buttons.forEach((button, i) =>
    button.addEventListener("click", () => {
      axis = block.axes[i];
      buttons.forEach((other) => other.setAttribute("aria-pressed", String(other === button)));
      charts.find((one) => one.place === place).draw();
    }),
  );
  element.append(el("div", { class: "choices" }, "Over ", el("div", { class: "switch", role: "group", "aria-label": "Over what" }, buttons)), place);
  captioned(element, block.caption);
}
