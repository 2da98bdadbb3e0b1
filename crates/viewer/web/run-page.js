// The run page: a grid of cases by conditions, with filters, and the tables of the report.
"use strict";

memtransfer.runPage = (current) => {
  const { h, runs, address, outcome, conditionParts, episodeAddress } = memtransfer;
  const number = Math.min(Math.max(Number(current.run) || 1, 1), runs.length);
  const run = runs[number - 1];
  let all = memtransfer.episodes(run);
  const filters = { page: "", run: runs.length > 1 ? number : "", memory: "", group: "", outcome: "", a: "", b: "", sort: "", tables: "", ...current };
  delete filters.key;

  const memories = [...new Map(run.conditions.map(({ memory, label }) => [memory, label]))];
  const used = () => new Set(all.map((episode) => episode.condition));

  function shownConditions() {
    const present = used();
    return run.conditions.map((condition, index) => ({ ...condition, index }))
      .filter(({ index, memory }) => present.has(index) && (!filters.memory || memory === filters.memory ||
        [filters.a, filters.b].includes(run.conditions[index].name)));
  }

  /** Whether conditions a and b have different outcomes in some repetition of the case. */
  function disagree(ofCase) {
    const results = (name) => {
      const condition = run.conditions.findIndex((one) => one.name === name);
      return new Map(ofCase.filter((episode) => episode.condition === condition)
        .map((episode) => [`${episode.repetition} ${episode.place}`, episode.outcome === 0]));
    };
    const [a, b] = [results(filters.a), results(filters.b)];
    return [...a].some(([repetition, success]) => b.has(repetition) && b.get(repetition) !== success);
  }

  function matches(episode) {
    if (!filters.outcome) return true;
    if (filters.outcome === "failure") return episode.outcome > 0;
    return outcome(run, episode.outcome).name === filters.outcome;
  }

  /** The cases that every filter but that of outcomes leaves, with their episodes under the conditions that are shown. */
  function scope() {
    const byCase = new Map();
    for (const episode of all) {
      if (!byCase.has(episode.case)) byCase.set(episode.case, []);
      byCase.get(episode.case).push(episode);
    }
    const visible = new Set(shownConditions().map(({ index }) => index));
    let found = [...byCase].map(([index, ofCase]) => ({ index, info: run.cases[index], ofCase, shown: ofCase.filter((episode) => visible.has(episode.condition)) }));
    if (filters.group) found = found.filter(({ info }) => run.groups[info.group] === filters.group);
    if (filters.a && filters.b) found = found.filter(({ ofCase }) => disagree(ofCase));
    return found;
  }

  /** The cases of `inScope` that have an episode of the chosen outcome, in the chosen order. */
  function rows(inScope) {
    const found = inScope.filter(({ shown }) => shown.some(matches));
    const failures = ({ shown }) => shown.filter((episode) => episode.outcome > 0).length;
    const steps = ({ shown }) => shown.reduce((sum, episode) => sum + episode.steps, 0) / shown.length;
    if (filters.sort === "failures") found.sort((a, b) => failures(b) - failures(a) || a.index - b.index);
    else if (filters.sort === "steps") found.sort((a, b) => steps(b) - steps(a) || a.index - b.index);
    else found.sort((a, b) => a.index - b.index);
    return found;
  }

  const select = (name, label, options) => h("label", {}, label,
    h("select", { name, onchange: (event) => change({ [name]: event.target.value }) },
      options.map(([value, text]) => h("option", { value, selected: filters[name] === value }, text))));

  function change(values) {
    Object.assign(filters, values);
    memtransfer.note(filters);
    for (const [name, value] of Object.entries(values)) {
      const field = document.querySelector(`select[name="${name}"]`);
      if (field) field.value = value;
    }
    draw();
  }

  const grid = h("div", { class: "grid", role: "region", "aria-label": "Episodes", tabindex: "0" });
  const head = h("thead", {});
  const body = h("tbody", {});
  // Arrow keys are the grid's own: with this role, screen readers pass them on.
  const table = h("table", { role: "grid" }, h("caption", { class: "hidden" }, "Outcome of each episode: cases by conditions"), head, body);
  const nothing = h("p", {}, "No episode fits these filters.");
  // Rows that are drawn, by case, and what they were drawn for: a row is drawn again when its case has more episodes.
  const drawn = new Map();
  let drawnFor = "";
  const count = h("p", { class: "count", "aria-live": "polite" });
  const legend = h("ul", { class: "outcomes", "aria-label": "Outcomes; choose one to see its episodes alone" });

  function drawLegend(inScope) {
    const focused = [...legend.children].findIndex((item) => item.contains(document.activeElement));
    const counts = new Map(all.map((episode) => [episode.outcome, 0]));
    for (const { outcome: key } of inScope) counts.set(key, counts.get(key) + 1);
    legend.replaceChildren(...[...counts.keys()].sort((a, b) => a - b).map((key) => {
      const { name, mark, style, meaning } = outcome(run, key);
      const pressed = filters.outcome === name;
      return h("li", {}, h("button", { type: "button", title: meaning, "aria-pressed": String(pressed), onclick: () => change({ outcome: pressed ? "" : name }) },
        h("span", { class: `mark ${style}`, "aria-hidden": "true" }, mark), ` ${name} `, h("b", {}, String(counts.get(key)))));
    }));
    if (focused >= 0) legend.children[focused].querySelector("button").focus();
  }

  function draw() {
    memtransfer.grids[number] = address(filters);
    const cases = scope();
    const inScope = cases.flatMap(({ shown }) => shown);
    drawLegend(inScope);
    const found = rows(cases);
    const conditions = shownConditions();
    const shown = found.reduce((sum, row) => sum + row.shown.filter(matches).length, 0);
    const planned = run.planned > all.length ? `, of ${run.planned} planned` : "";
    count.textContent = `${shown} of ${all.length} episodes${planned}, ${found.length} ${found.length === 1 ? "case" : "cases"}.`;
    const columns = [null, ...conditions];
    const heading = (name, value) => h("tr", {}, columns.map((condition) =>
      (condition ? h("th", { scope: "col" }, value(condition)) : h("th", { scope: "row" }, name))));
    const partNames = [...new Set(conditions.flatMap((condition) => conditionParts(condition).map(([name]) => name)))];
    const headings = [
      heading("memory", ({ label }) => h("span", { class: "memory" }, label)),
      ...partNames.map((name) => heading(name, (condition) => new Map(conditionParts(condition)).get(name) || "")),
      heading("successes", ({ index }) => {
        const ofCondition = inScope.filter((episode) => episode.condition === index);
        return `${ofCondition.filter((episode) => episode.outcome === 0).length}/${ofCondition.length}`;
      }),
    ];
    const cell = (row, { index }) => h("td", {}, row.shown.filter((episode) => episode.condition === index).map((episode) => {
      const { name, mark, style } = outcome(run, episode.outcome);
      const repetition = episode.place || `run ${episode.repetition}`;
      return h("a", {
        class: `mark ${style}${matches(episode) ? "" : " faded"}`, tabindex: "-1", href: episodeAddress(number, episode),
        "aria-label": `${row.info.id}, ${run.conditions[index].name}, ${repetition}: ${name}, ${episode.steps} steps`,
        title: `${name}, ${episode.steps} steps (reference ${episode.reference}), ${repetition}`,
      }, mark);
    }));
    const pair = (row) => {
      if (!filters.a || !filters.b) return null;
      const of = (name) => row.ofCase.find((episode) => run.conditions[episode.condition].name === name);
      const [a, b] = [of(filters.a), of(filters.b)];
      return a && b && h("a", { class: "pair", href: episodeAddress(number, a, { run2: number, key2: b.key }) }, "side by side");
    };
    head.replaceChildren(...headings);
    const { memory, outcome: wanted, a, b } = filters;
    const settings = JSON.stringify([memory, wanted, a, b, conditions.map(({ index }) => index)]);
    if (settings !== drawnFor) {
      drawn.clear();
      body.replaceChildren();
    }
    drawnFor = settings;
    found.forEach((row, at) => {
      const known = drawn.get(row.index);
      if (!known || known.size !== row.ofCase.length) {
        const element = h("tr", {},
          h("th", { scope: "row" }, h("span", { class: "case" }, row.info.id), h("span", { class: "instruction", title: row.info.instruction }, row.info.instruction), pair(row)),
          conditions.map((condition) => cell(row, condition)));
        if (known) known.element.replaceWith(element);
        drawn.set(row.index, { element, size: row.ofCase.length });
      }
      const { element } = drawn.get(row.index);
      if (body.rows[at] !== element) body.insertBefore(element, body.rows[at] || null);
    });
    while (body.rows.length > found.length) body.lastElementChild.remove();
    const first = body.querySelector("a.mark");
    if (first && !body.querySelector('a.mark[tabindex="0"]')) first.tabIndex = 0;
    const shownNow = found.length ? table : nothing;
    if (grid.firstElementChild !== shownNow) grid.replaceChildren(shownNow);
  }

  // One link of the grid can be reached with Tab; arrow keys move among the others.
  grid.addEventListener("keydown", (event) => {
    const cell = event.target.closest("td");
    const moves = { ArrowRight: [0, 1], ArrowLeft: [0, -1], ArrowDown: [1, 0], ArrowUp: [-1, 0] };
    if (!cell || !moves[event.key]) return;
    event.preventDefault();
    const [down, right] = moves[event.key];
    const marks = [...cell.querySelectorAll("a.mark")];
    let next = right ? marks[marks.indexOf(event.target) + right] : null;
    for (let row = cell.parentElement, at = cell.cellIndex + right; !next;) {
      if (down) row = down > 0 ? row.nextElementSibling : row.previousElementSibling;
      const candidate = row && row.cells[at];
      if (!candidate || candidate.tagName !== "TD") return;
      next = candidate.querySelector("a.mark");
      at += right;
    }
    event.target.tabIndex = -1;
    next.tabIndex = 0;
    next.focus();
  });

  const conditionOptions = [["", "any"], ...run.conditions.map(({ name }) => [name, name])];
  const outcomes = [["", "all"], ["failure", "every failure"], ["success", "success"], ...run.failures.map(([name]) => [name, name])];
  const form = h("form", { class: "filters", "aria-label": "Filters", onsubmit: (event) => event.preventDefault() },
    select("memory", "Memory", [["", "all"], ...memories]),
    select("group", "Tasks", [["", "all"], ...run.groups.map((group) => [group, group])]),
    select("outcome", "Outcome", outcomes),
    select("a", "Disagreement between", conditionOptions),
    select("b", "and the condition", conditionOptions),
    select("sort", "Sort by", [["", "case"], ["failures", "most failures"], ["steps", "most steps"]]),
    h("a", { class: "button", href: address({ run: filters.run }) }, "Clear"));

  const tables = h("details", { class: "tables", open: filters.tables === "1", ontoggle: (event) => openTables(event.target) }, h("summary", {}, "Tables and figures of the report"));
  function openTables(details) {
    if (details.open && !details.querySelector("iframe")) {
      details.append(h("iframe", { src: `${run.folder}/report.html`, title: `Report of ${run.name}` }));
    }
    memtransfer.note(Object.assign(filters, { tables: details.open ? "1" : "" }));
  }

  const live = h("div", { class: "live", "aria-live": "off" });
  const switcher = runs.length > 1 && h("nav", { "aria-label": "Runs" }, h("ul", { class: "switcher" }, runs.map((one, index) =>
    h("li", {}, h("a", { href: address({ run: index + 1 }), "aria-current": index + 1 === number ? "page" : null }, one.name)))));
  memtransfer.page(run.name,
    h("header", {}, h("h1", {}, run.name), switcher,
      h("dl", { class: "facts" }, run.facts.map(([name, value]) => h("div", {}, h("dt", {}, name), h("dd", {}, value))))),
    run.notices.map((notice) => h("p", { class: "notice" }, notice)),
    run.givenUp.length > 0 && h("details", { class: "notice" }, h("summary", {}, `${run.givenUp.length} episodes were given up`),
      h("ul", {}, run.givenUp.map(([key, error]) => h("li", {}, `${key}: ${error}`)))),
    live, form, legend, count,
    h("p", { class: "hint" }, "Choose an episode to see it step by step. Arrow keys move in the grid."), grid, tables);
  if (tables.open) openTables(tables);
  draw();
  const scroll = memtransfer.scrolls[memtransfer.grids[number]];
  if (scroll) {
    grid.scrollTo(...scroll.grid);
    window.scrollTo(...scroll.window);
  }
  const stop = memtransfer.isServed() ? memtransfer.follow(run, live, () => {
    all = memtransfer.episodes(run);
    draw();
  }) : () => {};
  return () => {
    stop();
    memtransfer.scrolls[memtransfer.grids[number]] = { grid: [grid.scrollLeft, grid.scrollTop], window: [window.scrollX, window.scrollY] };
  };
};

/**
 * Asks the server what `run` has added, until the returned function is called. Drawing a large grid takes long, on the cores that
 * the run needs: while it goes on, the page draws for at most 1/300 of the time.
 */
memtransfer.follow = (run, live, grown) => {
  const { h } = memtransfer;
  let timer = null;
  let isOver = false;
  // How often the server has read the whole run again.
  let knownRestarts = null;
  let isDrawn = true;
  let nextDrawing = 0;
  function draw() {
    const start = performance.now();
    grown();
    // With the layout, which the browser would compute later.
    document.body.getBoundingClientRect();
    const end = performance.now();
    isDrawn = true;
    nextDrawing = end + 300 * (end - start);
  }
  async function ask() {
    // A hidden page leaves the cores to the run.
    if (document.hidden) { timer = setTimeout(ask, 2000); return; }
    try {
      const answer = await fetch(`${run.folder}/new.json?from=${run.episodes.length}`);
      if (!answer.ok) throw new Error(`the server answered ${answer.status}`);
      const { restarts, rows, status } = await answer.json();
      if (isOver) return;
      // Its conditions may be others, too.
      if (restarts !== (knownRestarts ??= restarts)) { location.reload(); return; }
      run.episodes.push(...rows);
      if (rows.length) isDrawn = false;
      if (!isDrawn && (!status || performance.now() >= nextDrawing)) draw();
      live.replaceChildren(...(status ? [memtransfer.liveStatus(h, status)] : []));
      timer = setTimeout(ask, status ? 2000 : 5000);
    } catch (error) {
      if (isOver) return;
      live.replaceChildren(h("p", {}, `The server does not answer: ${error.message}`));
      timer = setTimeout(ask, 5000);
    }
  }
  timer = setTimeout(ask, 0);
  return () => { isOver = true; clearTimeout(timer); };
};

memtransfer.liveStatus = (h, status) => {
  const { episodes, steps_per_s: rate, waiting, lanes, phase } = status;
  const done = episodes.earlier[0] + episodes.finished[0] + episodes.given_up;
  const entry = (name, value) => h("div", {}, h("dt", {}, name), h("dd", {}, value));
  return h("dl", { class: "facts" }, entry("Now", phase), entry("Episodes", `${done} of ${episodes.planned}`),
    entry("Steps per second", Math.round(rate).toLocaleString("en")), entry("Lanes", String(lanes)),
    Object.entries(waiting).map(([name, count]) => entry(`Lanes that wait for ${name}`, String(count))));
};
