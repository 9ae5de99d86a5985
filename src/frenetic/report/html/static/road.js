// Roads and drives: from the page's numbers to shapes.

const COLOURS = 10; // of the path: half from half a lane outside to the lane's edge, half on to its centre
const POINT_SPACING = 2; // m, of a road's lines

/** The records of a drive, decoded once: columns in m, s, rad, m/s. */
const decoded = new WeakMap();

function recordsOf(drive) {
  if (!decoded.has(drive)) {
    const records = {};
    Object.entries(report.resolutions).forEach(([name, resolution], place) => {
      let value = 0;
      let slope = 0;
      records[name] = drive.columns[place].map((second) => {
        slope += second;
        value += slope;
        return value * resolution;
      });
    });
    decoded.set(drive, records);
  }
  return decoded.get(drive);
}

/** Curvature at a distance: linear between the samples. */
function curvatureAt(road, distance) {
  const last = road.curvatures.length - 1;
  const place = clamp(distance / road.step, 0, last);
  const i = Math.min(Math.floor(place), last - 1);
  return road.curvatures[i] + (place - i) * (road.curvatures[i + 1] - road.curvatures[i]);
}

/** A profile's value at a distance: linear between its stations, constant beyond; 0 without any. */
function profileAt(pairs = [], distance) {
  if (pairs.length === 0) return 0;
  const i = pairs.findIndex(([station]) => station > distance);
  if (i < 1) return pairs.at(i)[1];
  const [[start, before], [end, after]] = [pairs[i - 1], pairs[i]];
  return before + ((distance - start) / (end - start)) * (after - before);
}

/** The centre line's height above its start: the grade is linear between its stations. */
function heightAt(road, distance) {
  let [height, at] = [0, 0];
  for (const [station] of [...road.grade, [Infinity]]) {
    const to = Math.min(Math.max(station, at), Math.max(distance, 0));
    height += ((to - at) * (profileAt(road.grade, at) + profileAt(road.grade, to))) / 2;
    at = to;
  }
  return height;
}

/** A test's drive on its minimised road, or that on its own. */
function shortest(id) {
  const drive = drives.get(id);
  return drive.minimised === null ? drive : drive.minimised.drive;
}

function roadLength(road) {
  return road.step * (road.curvatures.length - 1);
}

/** The centre line: {x, y, heading, distance, wider} every POINT_SPACING m or less. */
function centreLine(road) {
  const length = roadLength(road);
  const steps = Math.max(1, Math.ceil(length / POINT_SPACING));
  const h = length / steps;
  let [x, y, heading] = road.pose;
  const widening = (distance) => profileAt(road.widening, distance); // of each lane, at its outer edge
  const line = [{ x, y, heading, distance: 0, wider: widening(0) }];
  for (let i = 0; i < steps; i++) {
    // Four pieces per step, Simpson's rule over the heading in each.
    const piece = h / 4;
    for (let k = 0; k < 4; k++) {
      const from = i * h + k * piece;
      const first = curvatureAt(road, from);
      const middle = curvatureAt(road, from + piece / 2);
      const end = curvatureAt(road, from + piece);
      const half = heading + (piece / 2) * ((first + middle) / 2);
      const next = half + (piece / 2) * ((middle + end) / 2);
      x += (piece / 6) * (Math.cos(heading) + 4 * Math.cos(half) + Math.cos(next));
      y += (piece / 6) * (Math.sin(heading) + 4 * Math.sin(half) + Math.sin(next));
      heading = next;
    }
    line.push({ x, y, heading, distance: (i + 1) * h, wider: widening((i + 1) * h) });
  }
  return line;
}

/** Where on the screen the world lies: turned as every picture of the road, y downwards. */
function viewOf(points, turn, aspect) {
  const [c, s] = [Math.cos(turn), Math.sin(turn)];
  const place = (x, y) => [c * x - s * y, -(s * x + c * y)];
  let [left, right, top, bottom] = [Infinity, -Infinity, Infinity, -Infinity];
  for (const { x, y } of points) {
    const [u, v] = place(x, y);
    left = Math.min(left, u);
    right = Math.max(right, u);
    top = Math.min(top, v);
    bottom = Math.max(bottom, v);
  }
  const around = Math.max(14, 0.04 * Math.max(right - left, bottom - top)); // m
  const height = Math.max((right - left + around) / aspect, bottom - top + around);
  const width = height * aspect;
  return { turn, box: [(left + right - width) / 2, (top + bottom - height) / 2, width, height], place };
}

function pathText(points) {
  return "M" + points.map(([x, y]) => `${x.toFixed(2)} ${y.toFixed(2)}`).join("L");
}

/** The road's left edge (side 1), centre line (0) or right edge (-1). */
function besideLine(line, side, view) {
  return line.map(({ x, y, heading, wider }) => {
    const offset = side * (report.lane_width + wider);
    return view.place(x - offset * Math.sin(heading), y + offset * Math.cos(heading));
  });
}

/** Which colour of the path an oob distance has: 0 is half a lane or more outside of the lane. */
function oobColour(oob) {
  return clamp(Math.floor((0.5 + oob / report.lane_width) * COLOURS), 0, COLOURS - 1);
}

/** The lanes and their edges as SVG elements. */
function roadShapes(line, view) {
  const [left, centre, right] = [1, 0, -1].map((side) => besideLine(line, side, view));
  const between = (one, other) => pathText([...one, ...[...other].reverse()]) + "Z";
  return [
    svg("path", { class: "lane-other", d: between(left, centre) }),
    svg("path", { class: "lane-ego", d: between(centre, right) }),
    svg("path", { class: "edge", d: pathText(left) }),
    svg("path", { class: "edge", d: pathText(right) }),
    svg("path", { class: "centre", d: pathText(centre) }),
  ];
}

/** The car's path as SVG elements, each with the colour of its oob distance. */
function pathShapes(records, view) {
  const shapes = [];
  let points = [];
  let last = null;
  records.x.forEach((x, i) => {
    const point = view.place(x, records.y[i]);
    const tint = oobColour(records.oob_distance[i]);
    points.push(point);
    if (last !== null && tint !== last) {
      shapes.push(tinted(`oob-${last}`, svg("path", { class: "path", d: pathText(points) })));
      points = [point];
    }
    last = tint;
  });
  if (points.length > 1) shapes.push(tinted(`oob-${last}`, svg("path", { class: "path", d: pathText(points) })));
  return shapes;
}

/** A small picture of a drive from above. */
function roadPicture(drive, label) {
  const line = centreLine(drive.road);
  const records = recordsOf(drive);
  const view = viewOf(placesOf(line, records), drive.road.turn, 1.6);
  const [startX, startY] = view.place(records.x[0], records.y[0]);
  const shapes = [...roadShapes(line, view), svg("circle", { class: "start", cx: startX, cy: startY, r: view.box[2] / 70 }), ...pathShapes(records, view)];
  if (drive.departure !== null) {
    const [x, y] = view.place(drive.departure.x, drive.departure.y);
    shapes.push(svg("circle", { class: "left-here", cx: x, cy: y, r: view.box[2] / 32 }));
  }
  return svg("svg", { viewBox: view.box.map((v) => v.toFixed(2)).join(" "), class: "picture", role: "img", "aria-label": label }, shapes);
}

/** What a picture has to show: a road and a path. */
function placesOf(line, records) {
  return [...line, ...records.x.map((x, i) => ({ x, y: records.y[i] }))];
}
