// The ancestors of a test as a tree, from the oldest on the left to the test on the right.

const MOST_NODES = 40;
const [NODE_WIDE, NODE_TALL, GAP_WIDE, GAP_TALL] = [118, 44, 34, 12];

/** The tests from which one descends: {levels, edges, left}; the nearest ones if there are many. */
function ancestry(id) {
  const nodes = new Map([[id, 0]]);
  let waiting = [id];
  let omitted = false;
  while (waiting.length) {
    const next = [];
    for (const child of waiting) {
      for (const parent of tests.get(child)?.parents ?? []) {
        if (!tests.has(parent)) continue;
        if (nodes.has(parent)) continue;
        if (nodes.size >= MOST_NODES) {
          omitted = true;
          continue;
        }
        nodes.set(parent, 0);
        next.push(parent);
      }
    }
    waiting = next;
  }
  // A parent stands left of all its children. Ids grow with time, so children come before parents.
  const edges = [];
  for (const child of [...nodes.keys()].sort((a, b) => b - a)) {
    for (const parent of new Set(tests.get(child).parents)) {
      if (!nodes.has(parent)) continue;
      edges.push([parent, child]);
      nodes.set(parent, Math.max(nodes.get(parent), nodes.get(child) + 1));
    }
  }
  return { nodes, edges, omitted };
}

/** The tree of a test as an element, null if it has no ancestors. */
function familyTree(id) {
  const { nodes, edges, omitted } = ancestry(id);
  if (nodes.size < 2) return null;
  const deepest = Math.max(...nodes.values());
  const levels = Array.from({ length: deepest + 1 }, () => []);
  for (const [node, level] of nodes) levels[level].push(node);
  const rows = new Map();
  levels.forEach((level) => {
    // Near the children, in their order.
    const wish = (node) => {
      const children = edges.filter(([parent]) => parent === node).map(([, child]) => rows.get(child) ?? 0);
      return children.length ? children.reduce((sum, row) => sum + row, 0) / children.length : 0;
    };
    const wishes = new Map(level.map((node) => [node, wish(node)]));
    level.sort((a, b) => wishes.get(a) - wishes.get(b) || a - b);
    const middle = level.reduce((sum, node) => sum + wishes.get(node), 0) / level.length;
    level.forEach((node, i) => rows.set(node, middle + i - (level.length - 1) / 2));
  });
  const top = Math.min(...rows.values());
  const left = (node) => (deepest - nodes.get(node)) * (NODE_WIDE + GAP_WIDE) + 3;
  const up = (node) => (rows.get(node) - top) * (NODE_TALL + GAP_TALL) + 3;
  const width = (deepest + 1) * (NODE_WIDE + GAP_WIDE) - GAP_WIDE + 6;
  const height = (Math.max(...rows.values()) - top) * (NODE_TALL + GAP_TALL) + NODE_TALL + 6;
  const lines = edges.map(([parent, child]) => {
    const [x1, y1] = [left(parent) + NODE_WIDE, up(parent) + NODE_TALL / 2];
    const [x2, y2] = [left(child), up(child) + NODE_TALL / 2];
    const bend = GAP_WIDE * 0.6;
    return svg("path", { d: `M${x1} ${y1}C${x1 + bend} ${y1} ${x2 - bend} ${y2} ${x2} ${y2}` });
  });
  const canvas = el("div", { class: "tree-canvas" }, svg("svg", { width, height, "aria-hidden": "true" }, lines));
  canvas.style.width = `${width}px`;
  canvas.style.height = `${height}px`;
  const inOrder = [...nodes.keys()].sort((a, b) => left(a) - left(b) || up(a) - up(b));
  for (const node of inOrder) {
    const item = treeNode(node, node === id, inOrder);
    item.style.left = `${left(node)}px`;
    item.style.top = `${up(node)}px`;
    item.style.width = `${NODE_WIDE}px`;
    item.style.height = `${NODE_TALL}px`;
    canvas.append(item);
  }
  const tree = scrollsSideways(el("div", { class: "tree", tabindex: 0, role: "group", "aria-label": `Ancestors of test ${id}` }, canvas));
  requestAnimationFrame(() => (tree.scrollLeft = tree.scrollWidth));
  const note = omitted ? el("p", { class: "quiet" }, `The ${MOST_NODES - 1} nearest of its ancestors.`) : null;
  const does = new Map(inOrder.map((node) => [tests.get(node).operator, tests.get(node).does]).filter(([, words]) => words).sort());
  const words = does.size ? el("p", { class: "quiet" }, [...does].map(([operator, text]) => `${operator}: ${text}`).join("; "), ".") : null;
  return el("div", { class: "tree-box" }, tree, note, words);
}

/** Makes trees no wider than so many pixels. */
function fitTrees(width) {
  for (const canvas of document.querySelectorAll(".tree-canvas")) {
    canvas.style.zoom = String(Math.min(1, (width - 50) / parseFloat(canvas.style.width)));
  }
}

function treeNode(id, isSelf, order) {
  const test = tests.get(id);
  const text = test.moobd === null ? test.outcome : `${test.outcome} ${fixed(test.moobd, 2, "m")}`;
  const parts = [
    el("span", { class: "node-id" }, String(id), el("span", { class: "node-operator" }, test.operator)),
    el("span", { class: "node-result" }, text),
  ];
  const style = `node outcome-${test.outcome.toLowerCase()}${isSelf ? " is-self" : ""}`;
  const does = test.does ? `${test.operator}: ${test.does}` : "";
  if (!drives.has(id)) return el("div", { class: `${style} is-closed`, title: `${does ? `${does}. ` : ""}Its drive is not in this report` }, parts);
  const opened = order.filter((other) => drives.has(other));
  return el("button", { type: "button", class: style, title: does || null, "aria-label": `Test ${id}, ${test.operator}, ${text}`, on: { click: () => player.open(id, opened) } }, parts);
}

function originText({ id, moobd, operator, does }) {
  return `Test ${id}, ${fixed(moobd, 2, "m")}, ${operator}${does ? `: ${does}` : ""}`;
}

function drawFamily(element, block) {
  const place = el("div", { "aria-live": "polite" });
  const choice = el("select", { id: "family-choice" }, block.ids.map((id) => el("option", { value: id }, originText(tests.get(id)))));
  const show = () => {
    const id = Number(choice.value);
    const none = el("p", { class: "quiet" }, `Test ${id} was a random road: it has no ancestors.`);
    place.replaceChildren(familyTree(id) ?? none);
  };
  choice.addEventListener("change", show);
  // The first that has a family says more than one that has none.
  choice.value = String(block.ids.find((id) => tests.get(id).parents.length) ?? block.ids[0]);
  show();
  element.append(el("div", { class: "choices" }, el("label", { for: "family-choice" }, "Ancestors of "), choice), place);
}
