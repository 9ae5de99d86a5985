// One test in a dialog: from above, replayed, and its profiles along the road.

const SPEEDS = [0.5, 1, 2, 4, 8];
const CLOSE_UP = 28; // m across
const CLOSE_UP_PHONE = 16;
const GENTLE = 0.02; // 1/m, range of curvatures that need more digits
const TO_SCALE = 500; // m across, up to which the car is drawn to scale; beyond, CAR_SHARE of them
const CAR_SHARE = 1 / 45;
const TICK_STEPS = [10, 20, 50, 100, 200, 500, 1000, 2000, 5000]; // m between numbers along the road
const BEFORE_FAILURE = 2.5; // s, how long before it a failing drive opens

/** What is shown along the road: each a plot with one line or more, of records or of the road. */
const PROFILES = [
  { title: "oob distance", unit: "m", digits: 2, lines: ["oob_distance"] },
  { title: "speed", unit: "km/h", digits: 0, scale: 3.6, lines: ["speed"] },
  { title: "lateral acceleration", side: true, unit: "m/s²", digits: 1, lines: ["lateral_acceleration"] },
  { title: "steering", side: true, unit: "°", digits: 1, scale: 180 / Math.PI, lines: ["steering"] },
  { title: "throttle, brake", unit: "%", digits: 0, scale: 100, most: 100, lines: ["throttle", "brake"] },
  { title: "curvature", side: true, unit: "1/\u2060m", digits: 3, lines: ["curvature"] },
  { title: "height", unit: "m", digits: 1, lines: ["height"] },
  { title: "grade", unit: "%", digits: 1, scale: 100, lines: ["grade"] },
  { title: "superelevation", falls: true, unit: "%", digits: 1, scale: 100, lines: ["superelevation"] },
];

/** Values of the road at a distance; of a road that has them. */
const OF_ROAD = {
  curvature: curvatureAt,
  height: heightAt,
  grade: (road, distance) => profileAt(road.grade, distance),
  superelevation: (road, distance) => profileAt(road.superelevation, distance),
};
const NEEDED = { height: "grade", grade: "grade", superelevation: "superelevation" };

const player = (() => {
  const dialog = document.getElementById("player");
  let shown = null; // what of the open test moves
  let playing = false;
  let speed = 1;
  let frame = 0;
  let clock = 0;

  /** Opens a test: its drive on its minimised road, if it has one, unless it is wanted as found. */
  function open(id, order = orderAround(id), asFound = false) {
    if (!drives.has(id)) return;
    pause();
    shown = build(asFound ? drives.get(id) : shortest(id), order);
    if (isEmbedded) dialog.open = true; // and takes no focus from the page around it
    else if (!dialog.open) dialog.showModal();
    dialog.scrollTop = 0;
    if (!isEmbedded) shown.slider.focus();
    seek(openingTime(shown.drive, shown.records));
    setFragment(`#test-${id}`);
  }

  function close() {
    dialog.close();
  }

  dialog.addEventListener("close", () => {
    pause();
    shown = null;
    dialog.replaceChildren();
    setFragment("");
  });
  dialog.addEventListener("click", (event) => {
    if (event.target === dialog) close(); // beside it
  });
  dialog.addEventListener("keydown", (event) => {
    if (shown === null || event.ctrlKey || event.metaKey || event.altKey) return;
    const isButton = event.target.matches("button, a, select");
    if (event.key === " " && !isButton) toggle();
    else if (event.key === "ArrowRight" && !event.target.matches("select")) seek(shown.time + (event.shiftKey ? 1 : 0.1));
    else if (event.key === "ArrowLeft" && !event.target.matches("select")) seek(shown.time - (event.shiftKey ? 1 : 0.1));
    else if (event.key === "Home") seek(0);
    else if (event.key === "End") seek(shown.end);
    else if (event.key === "+" || event.key === "=") faster(1);
    else if (event.key === "-") faster(-1);
    else if (event.key === "n") step(1);
    else if (event.key === "p") step(-1);
    else return;
    event.preventDefault();
  });

  // Time

  function toggle() {
    if (playing) pause();
    else play();
  }

  function play() {
    if (shown.time >= shown.end - 1e-6) seek(0);
    playing = true;
    clock = performance.now();
    frame = requestAnimationFrame(tick);
    showPlaying();
  }

  function pause() {
    playing = false;
    cancelAnimationFrame(frame);
    showPlaying();
  }

  function tick(now) {
    const passed = Math.max(0, now - clock) / 1000;
    clock = now;
    seek(shown.time + passed * speed);
    if (shown.time >= shown.end) pause();
    else if (playing) frame = requestAnimationFrame(tick);
  }

  function faster(by) {
    setSpeed(SPEEDS[clamp(SPEEDS.indexOf(speed) + by, 0, SPEEDS.length - 1)]);
  }

  function setSpeed(value) {
    speed = value;
    if (shown !== null) shown.speeds.value = String(value);
  }

  function step(by) {
    const at = shown.order.indexOf(shown.drive.id);
    const next = shown.order[at + by];
    if (next !== undefined) open(next, shown.order);
  }

  function showPlaying() {
    if (shown === null) return;
    shown.play.textContent = playing ? "Pause" : "Play";
    shown.play.setAttribute("aria-pressed", String(playing));
  }

  /** Shows the moment at so many seconds: car, cursor, numbers. */
  function seek(time) {
    const { records } = shown;
    shown.time = clamp(time, 0, shown.end);
    const at = momentAt(records, shown.time + records.time[0]);
    moveCars(shown.cars, at);
    const [u, v] = shown.view.place(at.x, at.y);
    const wide = shown.closeWide;
    const tall = wide / shown.closeAspect;
    shown.close.setAttribute("viewBox", `${u - wide / 2} ${v - tall / 2} ${wide} ${tall}`);
    const place = clamp(at.distance / shown.length, 0, 1);
    shown.cursor.style.left = `${100 * place}%`;
    shown.values.forEach((value, i) => {
      const { digits, unit, now } = shown.profiles[i];
      const numbers = now(at);
      // Where there is no room for it the unit comes on a line of its own.
      value.textContent = numbers.map((number, k) => fixed(number, digits, k === numbers.length - 1 ? unit : "")).join(", ").replace("\u00a0", " ");
    });
    showPicture();
    shown.slider.value = String(shown.time);
    shown.slider.setAttribute("aria-valuetext", `${fixed(shown.time, 1)} s, at ${fixed(at.distance, 0)} m`);
    shown.clock.textContent = `${fixed(shown.time, 1)} / ${fixed(shown.end, 1)} s`;
  }

  /** Shows the last picture of the film. */
  function showPicture() {
    const { film } = shown.drive;
    if (film === null) return;
    const i = clamp(lastUpTo(film.times, shown.time + 1e-6), 0, film.times.length - 1);
    const { columns, width, height } = film;
    shown.picture.setAttribute("viewBox", `${(i % columns) * width} ${Math.floor(i / columns) * height} ${width} ${height}`);
  }

  /** The pictures beside a replay. */
  function filmPart(film, state) {
    if (film === null) return null;
    const { columns, width, height, times, caption } = film;
    const rows = Math.ceil(times.length / columns);
    const sheet = svg("image", { href: film.pictures, width: columns * width, height: rows * height });
    state.picture = svg("svg", { class: "picture", id: "picture", role: "img", "aria-label": caption, viewBox: `0 0 ${width} ${height}` }, sheet);
    state.picture.style.aspectRatio = String(width / height);
    const parts = [el("figure", {}, state.picture, el("figcaption", {}, caption))];
    return el("div", { class: "film" }, parts);
  }

  function moveCars(cars, at) {
    const [u, v] = shown.view.place(at.x, at.y);
    const angle = (-(at.heading + shown.view.turn) * 180) / Math.PI;
    for (const car of cars) {
      car.setAttribute("transform", `translate(${u.toFixed(3)} ${v.toFixed(3)}) rotate(${angle.toFixed(2)})`);
      car.classList.toggle("is-out", at.oob_distance < 0);
    }
  }

  /** Shows the moment at which the car was so far along the road. */
  function seekDistance(distance) {
    const { records } = shown;
    let i = shown.along.findIndex((d) => d >= distance);
    if (i < 0) i = shown.along.length - 1;
    const before = Math.max(i - 1, 0);
    const span = shown.along[i] - shown.along[before];
    const share = span > 0 ? clamp((distance - shown.along[before]) / span, 0, 1) : 0;
    seek(records.time[before] + share * (records.time[i] - records.time[before]) - records.time[0]);
  }

  // Building

  function build(drive, order) {
    const records = recordsOf(drive);
    const line = centreLine(drive.road);
    // So that the profiles are in sight, too; as in the style sheet.
    const [isPhone, isNarrow] = [isOnPhone(), window.matchMedia("(max-width: 820px)").matches];
    const aspect = isPhone ? 1.4 : isNarrow ? 1.35 : clamp(window.innerWidth / window.innerHeight, 1.4, 1.65) * 1.55;
    const closeAspect = isPhone ? 0.7 : isNarrow ? 2.2 : 0.85;
    const closeWide = isPhone ? CLOSE_UP_PHONE : CLOSE_UP;
    const found = drives.get(drive.id);
    const view = viewOf(placesOf(line, records), drive.road.turn, aspect);
    const length = roadLength(drive.road);
    let furthest = -Infinity;
    const along = records.distance.map((d) => (furthest = Math.max(furthest, d)));
    const state = {
      drive, order, records, view, length, along, closeAspect, closeWide,
      time: 0,
      end: records.time[records.time.length - 1] - records.time[0],
      cars: [],
    };
    const main = scene(drive, line, records, view, state, true);
    main.setAttribute("viewBox", view.box.join(" "));
    main.style.aspectRatio = String(aspect);
    state.close = scene(drive, line, records, view, state, false);
    const plots = profilePlots(drive, records, length, state);
    const name = isEmbedded ? report.title : `Test ${drive.id}`;
    const at = order.indexOf(drive.id);
    state.play = el("button", { type: "button", class: "primary", id: "play", on: { click: toggle } }, "Play");
    state.slider = el("input", {
      type: "range", id: "scrub", min: 0, max: state.end, step: 0.01, value: 0, "aria-label": "Time of the replay",
      on: { input: () => { pause(); seek(Number(state.slider.value)); } },
    });
    state.clock = el("output", { class: "clock" });
    state.speeds = el(
      "select",
      { "aria-label": "Speed of the replay", on: { change: () => setSpeed(Number(state.speeds.value)) } },
      SPEEDS.map((value) => el("option", { value, selected: value === speed }, `${value}×`)),
    );
    dialog.replaceChildren(
      el(
        "header",
        { class: "player-head" },
        el("h2", { id: "player-title" }, name, " ", badge(drive.outcome)),
        el(
          "div",
          { class: "player-nav" },
          el("button", { type: "button", title: "Previous (p)", "aria-label": "Previous test", disabled: at <= 0, on: { click: () => step(-1) } }, "‹"),
          at < 0 || order.length < 2 ? null : el("span", { class: "quiet" }, `${at + 1} of ${order.length}`),
          el("button", { type: "button", title: "Next (n)", "aria-label": "Next test", disabled: at < 0 || at >= order.length - 1, on: { click: () => step(1) } }, "›"),
          el("button", { type: "button", class: "close", on: { click: close } }, "Close"),
        ),
      ),
      el("p", { class: "reason" }, drive.reason),
      ...lengthsOf(found, drive, order),
      el(
        "div",
        { class: "stage" },
        el("figure", { class: "stage-main" }, main, el("figcaption", {}, oobKey())),
        el("figure", { class: "stage-close" }, state.close, el("figcaption", {}, `${closeWide} m around the car`)),
      ),
      el("div", { class: "controls" }, state.play, state.slider, state.clock, state.speeds),
      ...[filmPart(drive.film, state)].filter((part) => part !== null),
      plots,
      ...(isEmbedded ? [] : [el("div", { class: "details" }, factsOf(drive), actionsOf(found))]),
    );
    return state;
  }

  /** Buttons for the minimised road and the one as found. */
  function lengthsOf(found, drive, order) {
    if (found.minimised === null) return [];
    const choice = (one, text) =>
      el("button", { type: "button", "aria-pressed": String(one === drive), on: { click: () => open(found.id, order, one === found) } }, `${text} ${fixed(roadLength(one.road), 0, "m")}`);
    return [el("div", { class: "switch roads", role: "group", "aria-label": "Road" }, choice(found.minimised.drive, "Cut to"), choice(found, "As found:"))];
  }

  function scene(drive, line, records, view, state, isMain) {
    const scale = isMain && view.box[2] > TO_SCALE ? (CAR_SHARE * view.box[2]) / drive.car[0] : 1;
    const car = carShape(drive, isMain ? { class: "car", id: "car" } : { class: "car" }, scale);
    state.cars.push(car);
    const parts = [...roadShapes(line, view), ...pathShapes(records, view)];
    if (isMain) {
      const [x, y] = view.place(records.x[0], records.y[0]);
      parts.push(svg("circle", { class: "start", cx: x, cy: y, r: view.box[2] / 150 }));
    }
    if (drive.departure !== null) {
      const [x, y] = view.place(drive.departure.x, drive.departure.y);
      parts.push(svg("circle", { class: "left-here", cx: x, cy: y, r: isMain ? view.box[2] / 60 : 1.2 }));
    }
    for (const breach of drive.breaches) {
      const [x, y] = view.place(breach.x, breach.y);
      parts.push(svg("circle", { class: "broke-here", cx: x, cy: y, r: isMain ? view.box[2] / 90 : 0.8 }));
    }
    const label = isMain ? "The road from above, with the car's path and the car" : "The car close up";
    return svg("svg", { class: "scene", role: "img", "aria-label": label }, parts, car);
  }

  function carShape(drive, attributes, scale) {
    const [length, width, ahead] = drive.car.map((size) => scale * size);
    return svg(
      "g",
      attributes,
      svg("rect", { class: "body", x: ahead - length / 2, y: -width / 2, width: length, height: width, rx: 0.35 * scale }),
      svg("path", { class: "screen", d: `M${ahead + length * 0.14} ${-width * 0.36}L${ahead + length * 0.26} ${-width * 0.28}V${width * 0.28}L${ahead + length * 0.14} ${width * 0.36}Z` }),
    );
  }

  function profilePlots(drive, records, length, state) {
    const { step, curvatures } = drive.road;
    const isThere = ({ lines: [name] }) => NEEDED[name] === undefined || drive.road[NEEDED[name]] !== undefined;
    const places = Array.from({ length: 401 }, (_, i) => (i * length) / 400);
    const own = PROFILES.filter(isThere).map((profile) => {
      const scale = profile.scale ?? 1;
      const recorded = (name) => records[name].map((value, i) => [records.distance[i], scale * value]);
      const isOfRoad = OF_ROAD[profile.lines[0]] !== undefined;
      const along = (name) => (name === "curvature" ? curvatures.map((value, i) => [i * step, value]) : places.map((place) => [place, scale * OF_ROAD[name](drive.road, place)]));
      const pointsOf = (name) => (isOfRoad ? along(name) : recorded(name));
      return {
        ...profile,
        now: (at) => profile.lines.map((name) => scale * (isOfRoad ? OF_ROAD[name](drive.road, at.distance) : at[name])),
        points: profile.lines.map(pointsOf),
        limits: profile.title === "speed" ? drive.speed_limits : [],
      };
    });
    state.profiles = own;
    state.values = [];
    state.cursor = el("div", { class: "cursor", id: "cursor" });
    const marks = [];
    if (drive.departure !== null) {
      const mark = el("div", { class: "mark", title: "departure" });
      mark.style.left = `${100 * clamp(drive.departure.distance / length, 0, 1)}%`;
      marks.push(mark);
    }
    for (const breach of drive.breaches) {
      const mark = el("div", { class: "mark broke", title: breach.words });
      mark.style.left = `${100 * clamp(breach.distance / length, 0, 1)}%`;
      marks.push(mark);
    }
    const area = el("div", { class: "plot-area", id: "profiles" }, own.map((profile) => plotOf(profile, length)), marks, state.cursor);
    const follow = (event) => {
      const box = area.getBoundingClientRect();
      pause();
      seekDistance((length * clamp(event.clientX - box.left, 0, box.width)) / box.width);
    };
    area.addEventListener("pointermove", follow);
    area.addEventListener("pointerdown", follow);
    const names = own.map((profile) => {
      const value = el("span", { class: "now" });
      state.values.push(value);
      const width = profile.range[1] - profile.range[0];
      const [low, high] = profile.range.map((end) => fixed(end, width < GENTLE ? 3 : width < 0.5 ? 2 : width < 8 ? 1 : 0));
      const title = profile.lines.length === 1 ? [profile.title] : profile.lines.flatMap((name, i) => [i ? ", " : "", el("span", { class: `key-${name}` }, name)]);
      return el("div", { class: "plot-name", title: profile.side ? "Positive to the left" : profile.falls ? "Positive: falls to the right" : null }, el("span", {}, ...title), value, el("span", { class: "high" }, high), el("span", { class: "low" }, low));
    });
    const ticks = el("div", { class: "plot-ticks" });
    const most = isOnPhone() ? 5 : 8; // that have room
    const every = TICK_STEPS.find((step) => length / step <= most) ?? TICK_STEPS.at(-1);
    for (let place = 0; place <= length; place += every) {
      const tick = el("span", {}, place === 0 ? "0 m" : String(place));
      tick.style.left = `${(100 * place) / length}%`;
      ticks.append(tick);
    }
    return el(
      "div",
      { class: "plots" },
      el("div", { class: "plot-names" }, names),
      area,
      ticks,
    );
  }

  function plotOf(profile, length) {
    const values = profile.points.flat().map(([, value]) => value);
    let low = Math.min(...values, 0);
    let high = Math.max(...values, 0, ...profile.limits.map(([, limit]) => limit), profile.most ?? -Infinity);
    if (profile.lines[0] === "oob_distance") high = Math.max(high, report.lane_width / 2);
    profile.range = [low, high];
    if (high - low < GENTLE) profile.digits = 4;
    const room = 0.08 * (high - low) || 1;
    [low, high] = [low - room, high + room];
    const [wide, tall] = [1000, 100];
    const across = (distance) => (wide * distance) / length;
    const up = (value) => tall * (1 - (value - low) / (high - low));
    const shapes = [];
    if (profile.lines[0] === "oob_distance") shapes.push(svg("rect", { class: "outside", x: 0, y: up(0), width: wide, height: Math.max(0, tall - up(0)) }));
    shapes.push(svg("path", { class: "zero", d: `M0 ${up(0)}H${wide}` }));
    if (profile.limits.length > 0) {
      const steps = profile.limits.map(([place, limit], i) => `${i === 0 ? "M0 " : `H${across(place)}V`}${up(limit)}`);
      shapes.push(svg("path", { class: "limit", d: `${steps.join("")}H${wide}` }));
    }
    const line = (name, points) => svg("path", { class: `line ${name}`, d: pathText(points.map(([d, v]) => [across(d), up(v)])) });
    shapes.push(...profile.points.map((points, i) => line(`line-${profile.lines[i]}`, points)));
    const label = `${profile.title} in ${profile.unit} along the road`;
    return el(
      "div",
      { class: "plot" },
      svg("svg", { viewBox: `0 0 ${wide} ${tall}`, preserveAspectRatio: "none", role: "img", "aria-label": label }, shapes),
    );
  }

  return { open, close, get state() { return shown; } };
})();

/** The tests among which one stands that is opened by itself: the heads of the clusters, or its cluster, or all. */
function orderAround(id) {
  const clusters = report.blocks.find((block) => block.kind === "gallery")?.clusters ?? [];
  const heads = clusters.map((cluster) => cluster.shown[0]).filter((head) => head !== undefined);
  const own = [heads, ...clusters.map((cluster) => cluster.shown)].find((order) => order.includes(id));
  return own ?? [...drives.keys()].sort((a, b) => a - b);
}

/** Whether the page is laid out for a phone, as in the style sheet. */
function isOnPhone() {
  return window.matchMedia("(max-width: 560px)").matches;
}

/** The time at which a drive opens: shortly before its failure; the start if it passed. */
function openingTime(drive, records) {
  if (drive.outcome !== "FAIL") return 0;
  const failure = drive.departure ?? drive.breaches[0];
  return (failure?.time ?? records.time.at(-1)) - records.time[0] - BEFORE_FAILURE;
}

/** The car at a time, between records. */
function momentAt(records, time) {
  const { time: times } = records;
  const low = clamp(lastUpTo(times, time), 0, Math.max(0, times.length - 2));
  const high = Math.min(low + 1, times.length - 1);
  const span = times[high] - times[low];
  const share = span > 0 ? clamp((time - times[low]) / span, 0, 1) : 0;
  const between = (name) => records[name][low] + share * (records[name][high] - records[name][low]);
  return Object.fromEntries(Object.keys(report.resolutions).map((name) => [name, between(name)]));
}

/** Key to the colours of a path: from the lane's centre over its edge to half a lane outside. */
function oobKey() {
  const ramp = (from) => el("span", { class: "ramp" }, Array.from({ length: COLOURS / 2 }, (_, i) => tinted(`oob-${from - i}`, el("i", {}))));
  const half = fixed(report.lane_width / 2, Number.isInteger(report.lane_width / 2) ? 0 : 2);
  return ["Path by oob distance: ", el("span", { class: "oob-key" }, `lane centre ${half}\u00a0m`, ramp(COLOURS - 1), el("b", {}, "lane edge 0"), ramp(COLOURS / 2 - 1), `outside −${half}\u00a0m`)];
}

function badge(outcome) {
  return el("span", { class: `badge outcome-${outcome.toLowerCase()}` }, outcome);
}

function factsOf(drive) {
  const facts = [
    ["MOOBD", `${oobWords(drive.moobd)}${drive.moobd_distance === null ? "" : `, at ${fixed(drive.moobd_distance, 0, "m")}`}`],
    ["Largest oob share", percent(drive.max_oob_share)],
    ["Left its lane", drive.departure === null ? "no" : `to the ${drive.departure.side}, at ${fixed(drive.departure.distance, 0, "m")} after ${fixed(drive.departure.time, 1, "s")}`],
    ...drive.breaches.map((breach) => ["Exceeded a limit", breach.words]),
    ...drive.kept.map((words) => ["Kept", words]),
    ["Duration", fixed(drive.duration, 1, "s")],
    ["Road", drive.road.words],
    ["Origin", drives.get(drive.id).origin],
  ];
  if (drive.mistake !== null) facts.unshift(["First mistake", drive.mistake.text]);
  const cause = tests.get(drive.id)?.cause;
  if (cause) facts.unshift(["Cause", cause]);
  const again = repeats.get(drive.id);
  if (again !== undefined) facts.push([`Driven again: ${again.stability}`, again.text]);
  for (const { where, text } of elsewhere.get(drive.id) ?? []) facts.push([`In ${where}`, text]);
  return el("dl", { class: "facts" }, facts.map(([name, value]) => el("div", {}, el("dt", {}, name), el("dd", {}, value))));
}

function actionsOf(drive) {
  const { campaign, is_named: isNamed } = report; // rather than made in Python
  const parts = [];
  if (drive.road_file !== null) {
    const line = `frenetic drive ${joined(campaign, drive.road_file)}`;
    parts.push(commandLine(line, isNamed ? "Drive it again" : "Drive its road, with the driver of your choice"));
  }
  parts.push(commandLine(`frenetic show ${campaign} ${drive.id}`, "Show it in full, with a picture"));
  if (drive.outcome === "FAIL" && isNamed && drive.minimised === null) parts.push(commandLine(`frenetic minimise ${campaign} ${drive.id}`, "Find the shortest road that fails like it"));
  if (drive.minimised !== null) {
    const line = `frenetic drive ${joined(campaign, drive.minimised.file)}`;
    parts.unshift(commandLine(line, isNamed ? "Drive the minimised road again" : "Drive the minimised road, with the driver of your choice"));
  }
  return el("div", { class: "actions" }, parts);
}

/** A file in the campaign's folder, whose name may be quoted. */
function joined(campaign, file) {
  const quote = campaign.at(-1);
  return quote === "'" || quote === '"' ? `${campaign.slice(0, -1)}/${file}${quote}` : `${campaign}/${file}`;
}
