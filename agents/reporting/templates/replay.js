// The player of the replay: its data are described in agents/reporting/maps.py.
(() => {
  "use strict";
  const data = JSON.parse(document.getElementById("replay-data").textContent);
  const find = (id) => document.getElementById(id);
  const [task, algorithm, seed, time] =
    ["task", "algorithm", "seed", "time"].map((name) => find("replay-" + name));
  const episode = find("episode"), curve = find("curve"), words = find("replay-words");
  const SIDE = episode.viewBox.baseVal.width, STATES = data.states;
  const PLOT = { left: 46, right: 488, top: 34, bottom: 284 };
  let run, episodes;

  const bytes = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const count = (number) => number.toLocaleString("en-US");

  // Indices of an episode's steps that are drawn, by the rule of derive.shown_states.
  function shownStates(length) {
    const every = Math.ceil(length / STATES), shown = [];
    for (let k = 0; k < length - 1; k += every) shown.push(k);
    return [...shown, length - 1];
  }

  // First step and length of the longest streak of cost steps; of equal ones, the first.
  function longestChain(unsafe) {
    let best = { start: 0, length: 0 }, length = 0;
    unsafe.forEach((cost, k) => {
      length = cost ? length + 1 : 0;
      if (length > best.length) best = { start: k - length + 1, length };
    });
    return best;
  }

  // Read numbers of a given number of bits, the highest bit first.
  function bitReader(text) {
    const read = bytes(text);
    let at = 0;
    return (bits) => {
      let number = 0;
      for (; bits > 0; bits--, at++) number = (number << 1) | ((read[at >> 3] >> (7 - (at & 7))) & 1);
      return number;
    };
  }

  // All episodes of a run: points in the picture's units, whether each step cost, longest streak.
  function decoded(run) {
    const point = bitReader(run.points), cost = bitReader(run.unsafe), last = 2 ** data.bits - 1;
    const [left, right, bottom, top] = data.extents[run.scene], [x0, y0, x1, y1] = run.box;
    return run.window.map((window, k) => {
      const length = Array.isArray(run.length) ? run.length[k] : run.length;
      const shown = shownStates(length);
      const path = shown.map(() => {
        const x = x0 + (x1 - x0) * point(data.bits) / last;
        const y = y0 + (y1 - y0) * point(data.bits) / last;
        return [SIDE * (x - left) / (right - left), SIDE * (top - y) / (top - bottom)];
      });
      const unsafe = Array.from({ length }, () => cost(1)), chain = longestChain(unsafe);
      const total = run.cost ? run.cost[k] : unsafe.filter(Boolean).length;
      return { path, shown, unsafe, chain, length, mcc: chain.length / length, window,
        start: run.start[k], cost: total };
    });
  }

  const point = ([x, y]) => x.toFixed(1) + " " + y.toFixed(1);
  const line = (points) => points.length
    ? "M" + points.map(point).join("L") + (points.length > 1 ? "" : "h0") : "";
  const set = (parent, selector, d) => parent.querySelector(selector).setAttribute("d", d);

  function drawEpisode(shown) {
    const { path, chain, unsafe } = shown, end = chain.start + chain.length;
    // Each state that is drawn stands for the steps since the one before it.
    const before = shown.shown.map((step, k) => k ? shown.shown[k - 1] + 1 : 0);
    const states = (holds) => path.filter((_, k) => holds(before[k], shown.shown[k]));
    const costly = states((from, to) => unsafe.slice(from, to + 1).includes(1));
    set(episode, ".way", line(path));
    set(episode, ".costs", costly.map((p) => "M" + point(p) + "h0").join(""));
    set(episode, ".chain", line(states((from, to) => from < end && to >= chain.start)));
    const [x, y] = path[0];
    set(episode, ".first", `M${x - 16} ${y}a16 16 0 1 0 32 0a16 16 0 1 0 -32 0`);
  }

  const across = (step) => PLOT.left + (PLOT.right - PLOT.left) * step / run.steps;
  const up = (value) => PLOT.bottom - (PLOT.bottom - PLOT.top) * value;

  function element(name, attributes, text) {
    const made = document.createElementNS("http://www.w3.org/2000/svg", name);
    for (const key in attributes) made.setAttribute(key, attributes[key]);
    if (text !== undefined) made.textContent = text;
    curve.append(made);
    return made;
  }

  function drawCurve() {
    curve.replaceChildren();
    for (const value of [0, 0.5, 1]) {
      element("path", { class: "axis", d: `M${PLOT.left} ${up(value)}H${PLOT.right}` });
      element("text", { x: PLOT.left - 8, y: up(value) + 5, "text-anchor": "end" }, value);
    }
    for (const part of data.parts) {
      const x = across(part * run.steps);
      element("path", { class: "parts", d: `M${x} ${PLOT.top}V${PLOT.bottom}` });
    }
    for (const [share, anchor] of [[0, "start"], [1, "end"]]) {
      const x = across(share * run.steps), y = PLOT.bottom + 20;
      element("text", { x, y, "text-anchor": anchor }, count(share * run.steps));
    }
    const middle = (PLOT.left + PLOT.right) / 2;
    element("text", { x: middle, y: PLOT.bottom + 38, "text-anchor": "middle" },
      "environment steps");
    element("text", { x: 8, y: 16 }, "EMCC, MCC");
    let d = "", broken = true;
    run.emcc.forEach((value, k) => {
      if (value !== null) {
        const x = across((k + 0.5) / run.emcc.length * run.steps);
        d += (broken ? "M" : "L") + point([x, up(value / data.digits)]);
      }
      broken = value === null;
    });
    element("path", { class: "emcc", d });
    for (const { start, mcc } of episodes) {
      element("circle", { class: "mcc", cx: across(start), cy: up(mcc), r: 3 });
    }
    element("path", { class: "cursor", d: "" });
    element("circle", { class: "mcc now", r: 6 });
  }

  function show() {
    const shown = episodes[time.value];
    drawEpisode(shown);
    const x = across(shown.start), now = curve.querySelector(".now");
    set(curve, ".cursor", `M${x} ${PLOT.top}V${PLOT.bottom}`);
    now.setAttribute("cx", x);
    now.setAttribute("cy", up(shown.mcc));
    const chain = `longest streak ${shown.chain.length} of ${shown.length} steps`;
    const text = `Window ${shown.window + 1} of ${data.windows}, the episode from step ` +
      `${count(shown.start)}: MCC ${shown.mcc.toFixed(2)} (${chain}), cost ` +
      `${shown.cost.toLocaleString("en-US", { maximumFractionDigits: 2 })}`;
    words.textContent = text + ".";
    time.setAttribute("aria-valuetext", `step ${count(shown.start)}`);
    const who = `${run.algorithm}, seed ${run.seed}, on ${run.task}`;
    episode.setAttribute("aria-label", `Path of ${who}. ${text}`);
    curve.setAttribute("aria-label", `Running EMCC of ${who}; the cursor is at step ` +
      `${count(shown.start)}, where the episode's MCC is ${shown.mcc.toFixed(2)}`);
  }

  function choose() {
    run = data.runs[seed.value];
    episodes = decoded(run);
    for (const layer of ["below", "above"]) {
      find("replay-" + layer).setAttribute("href", `#${layer}-${run.scene}`);
    }
    const share = time.max > 0 ? time.value / time.max : 0;
    time.max = episodes.length - 1;
    time.value = Math.round(share * time.max);
    drawCurve();
    show();
  }

  // Fill a menu with [value, text] pairs; keep the chosen value if it is among them.
  function fill(menu, pairs) {
    const last = menu.selectedOptions[0]?.textContent;
    menu.replaceChildren(...pairs.map(([value, text]) => new Option(text, value)));
    const same = pairs.find(([, text]) => String(text) === last);
    if (same) menu.value = same[0];
  }

  const numbered = data.runs.map((run, k) => ({ ...run, k }));
  const distinct = (runs, key) => [...new Set(runs.map((run) => run[key]))].map((v) => [v, v]);
  const ofTask = () => numbered.filter((run) => run.task === task.value);
  function fillSeeds() {
    const runs = ofTask().filter((run) => run.algorithm === algorithm.value);
    fill(seed, runs.map((run) => [run.k, run.seed]));
    choose();
  }
  function fillAlgorithms() {
    fill(algorithm, distinct(ofTask(), "algorithm"));
    fillSeeds();
  }

  function pointAt(event) {
    const box = curve.getBoundingClientRect();
    const x = (event.clientX - box.left) * curve.viewBox.baseVal.width / box.width;
    const off = episodes.map(({ start }) => Math.abs(across(start) - x));
    time.value = off.indexOf(Math.min(...off));
    show();
  }

  task.addEventListener("change", fillAlgorithms);
  algorithm.addEventListener("change", fillSeeds);
  seed.addEventListener("change", choose);
  time.addEventListener("input", show);
  curve.addEventListener("pointerdown", pointAt);
  curve.addEventListener("pointermove", (event) => event.buttons && pointAt(event));
  fill(task, distinct(numbered, "task"));
  fillAlgorithms();
})();
