const { spawn } = require("node:child_process");
const { createInterface } = require("node:readline");

const words = ["ask-tell", "--out", "told-js", "--simulations", "40", "--seed", "1", "--name", "toy"];
const search = spawn("frenetic", words, { stdio: ["pipe", "pipe", "inherit"] });
const answers = createInterface({ input: search.stdout })[Symbol.asyncIterator]();

async function call(request) {
  search.stdin.write(JSON.stringify(request) + "\n");
  return JSON.parse((await answers.next()).value);
}

(async () => {
  for (let answer; (answer = await call({ ask: {} })).candidate; ) {
    const { id, curvatures } = answer.candidate; // your simulator drives candidate.points here
    const moobd = 1.5 - 40 * Math.max(...curvatures.map(Math.abs));
    await call({ tell: { id, outcome: moobd < 0 ? "FAIL" : "PASS", moobd } });
  }
  console.log((await call({ end: {} })).summary.failed, "failures");
})();
