// What all pages share: data that arrive as scripts, elements, the state in the address.
"use strict";

const memtransfer = (() => {
  const arrived = new Map();
  const awaited = new Map();

  /** Called by every data script with its name and value. */
  function receive(name, value) {
    arrived.set(name, value);
    if (name === "runs") start(value);
  }

  /** The value of the data script `name`, loaded once. A page from the disk may load scripts, but fetch nothing. */
  function load(name) {
    if (arrived.has(name)) return Promise.resolve(arrived.get(name));
    if (!awaited.has(name)) {
      awaited.set(name, new Promise((resolve, reject) => {
        const script = document.createElement("script");
        script.src = `${name}.js`;
        script.onload = () => resolve(arrived.get(name));
        script.onerror = () => {
          awaited.delete(name);
          reject(new Error(`${name}.js cannot be loaded`));
        };
        script.addEventListener("load", () => script.remove());
        document.head.append(script);
      }));
    }
    return awaited.get(name);
  }

  const SVG = "http://www.w3.org/2000/svg";
  const SVG_TAGS = new Set(["svg", "path", "rect", "circle", "text", "g", "polyline", "title"]);

  /** Makes an element. Attributes that begin with `on` are listeners. Text is never read as HTML. */
  function h(tag, attributes, ...children) {
    const element = SVG_TAGS.has(tag) ? document.createElementNS(SVG, tag) : document.createElement(tag);
    for (const [name, value] of Object.entries(attributes || {})) {
      if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
      else if (value === true) element.setAttribute(name, "");
      else if (value !== false && value !== null && value !== undefined) element.setAttribute(name, value);
    }
    element.append(...children.flat(3).filter((child) => child !== null && child !== undefined && child !== false));
    return element;
  }

  /** The state of the page: what the address says after #. */
  const state = () => Object.fromEntries(new URLSearchParams(location.hash.slice(1)));

  /** The address of a state; empty values are left out. */
  function address(values) {
    const entries = Object.entries(values).filter(([, value]) => value !== "" && value !== null && value !== undefined);
    return `#${new URLSearchParams(entries)}`;
  }

  // What `show` or `note` has last seen in the address.
  let noted = "";

  /**
   * Changes the address without another entry in the history, and without showing the page again. An address that has
   * been opened and is not shown yet stays: its `hashchange` is on its way.
   */
  function note(values) {
    if (location.hash !== noted) return;
    history.replaceState(null, "", address(values));
    noted = location.hash;
  }

  const runs = [];
  let served = false;

  async function start({ folders, served: isServed }) {
    served = isServed;
    try {
      for (const folder of folders) {
        const run = await load(`${folder}/run`);
        runs.push({ folder, ...run });
      }
    } catch (error) {
      return fail(error);
    }
    window.addEventListener("hashchange", show);
    // The browser would scroll the page that is being left.
    history.scrollRestoration = "manual";
    show();
  }

  function fail(error) {
    page("Error", h("h1", {}, "This page cannot be shown"), h("p", { role: "alert" }, error.message),
      h("p", {}, h("a", { href: "#" }, "Back to the run")));
  }

  let leave = () => {};
  let navigation = 0;

  async function show() {
    navigation += 1;
    const ours = navigation;
    noted = location.hash;
    leave();
    leave = () => {};
    const current = state();
    try {
      if (current.page === "episode") {
        const episodes = await memtransfer.loadEpisodes(current);
        // Another address may have been opened meanwhile.
        if (ours === navigation) leave = memtransfer.episodePage(current, episodes);
      } else leave = memtransfer.runPage(current);
    } catch (error) {
      if (ours === navigation) fail(error);
    }
  }

  /** Replaces the page, and moves the focus to it. */
  function page(title, ...content) {
    document.title = `${title} · MemTransfer`;
    const main = document.getElementById("main");
    main.replaceChildren(...content.flat().filter(Boolean));
    main.focus({ preventScroll: true });
    window.scrollTo(0, 0);
  }

  const CODES = { "no-return": "NR", "no-revisit": "NV", "missed-instance": "MI", "never-saw": "NS", "saw-and-left": "SL", "wrong-order": "WO" };

  /** Name, short mark and class of an outcome of `run`. */
  function outcome(run, number) {
    if (number === 0) return { name: "success", mark: "✓", style: "success", meaning: "the task was completed" };
    const [name, meaning] = run.failures[number - 1];
    return { name, mark: CODES[name] || name.slice(0, 2).toUpperCase(), style: `failure-${name}`, meaning };
  }

  /** What a condition is beside its memory: a name and a value for each part. */
  function conditionParts({ rest }) {
    const [start, route, demonstrations, ...deviations] = rest.split("/");
    return [["start", start], ["route", route], ["demonstrations", demonstrations], ["deviations", deviations.join(", ")]].filter(([, value]) => value);
  }

  /** The episodes of `run` as objects. */
  const episodes = (run) => run.episodes.map(([key, condition, kase, repetition, result, steps, reference, views, place], index) =>
    ({ index, key, condition, case: kase, repetition, outcome: result, steps, reference, views, place }));

  const episodeAddress = (runNumber, episode, more) => address({ page: "episode", run: runNumber, key: episode.key, ...more });

  // By number of a run: the address of its grid as it was seen last.
  const grids = {};
  // By the address of a grid: to where it and the window were scrolled when it was left.
  const scrolls = {};

  return { receive, load, h, state, address, note, runs, grids, scrolls, page, outcome, conditionParts, episodes, episodeAddress, isServed: () => served };
})();
