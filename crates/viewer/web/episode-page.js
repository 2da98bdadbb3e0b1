// The episode page: one episode step by step, or two side by side.
"use strict";

/** One episode: its view, its map, and what happened at a step. */
memtransfer.EpisodeView = class {
  constructor(run, row, episode, onSource) {
    const { h } = memtransfer;
    Object.assign(this, { run, row, episode, onSource });
    this.map = new memtransfer.EpisodeMap(run, episode);
    this.image = h("img", { class: "view", width: 320, height: 320, alt: "" });
    this.noView = h("p", { class: "no-view" }, "This bundle has no views of this episode: write it with ", h("code", {}, "--episodes all"), ", or use ", h("code", {}, "--serve"), ".");
    this.hasMap = run.map[2] > 0;
    this.conflict = this.hasMap ? "tried to enter the closed passage" : "ran into what blocks the way";
    this.happening = h("p", { class: "happening" });
    this.memory = h("div", { class: "memory" });
    const hasViews = episode.views.length > 0;
    this.camera = h("figure", { class: "camera" }, hasViews ? this.image : this.noView, h("figcaption", {}, this.happening));
  }

  get last() { return this.episode.poses.length - 1; }

  action(step) { return this.run.actions[this.episode.actions[step - 1]] || "an answer that could not be read"; }

  /** The item of a visit: its letter and its name. */
  item({ letter, cell }) {
    const target = this.episode.targets.find((one) => one.letter === letter && one.cell.join() === cell.join());
    return target ? `${letter}, ${target.name}` : letter;
  }

  /** What happened in the step before `step` and what is next, in words. */
  words(step) {
    const { episode, run } = this;
    const [x, y, heading] = episode.poses[step];
    const before = step === 0 ? "Start." : `Action ${step}: ${this.action(step)}. ${run.feedback[episode.feedback[step]]}`;
    const met = episode.subGoals.filter((at) => at === step).length;
    const visit = episode.visits.find((one) => one.step === step);
    return [before, visit && `Stands before ${this.item(visit)}.`, met > 0 && "A sub-goal is complete.",
      episode.conflictAt === step && `The agent ${this.conflict}.`,
      episode.failure && episode.failure.step === step && `Failed, ${episode.failure.kind}.`,
      ...this.points().filter(([at]) => at === step).map(([, , , words]) => `From here ${words}.`),
      this.hasMap ? `Column ${x}, row ${y}, facing ${memtransfer.HEADINGS[heading]}.` : `State: ${episode.states[step]}.`].filter(Boolean).join(" ");
  }

  show(wanted) {
    const step = Math.min(wanted, this.last);
    const { h } = memtransfer;
    const { episode, run } = this;
    if (episode.views.length) {
      this.image.src = run.views + episode.views[step];
      this.image.alt = `The agent's view after step ${step}`;
      for (const next of episode.views.slice(step + 1, step + 4)) new Image().src = run.views + next;
    }
    this.happening.textContent = this.words(step);
    const supplied = episode.supplied[step] || [];
    const source = supplied.length ? [episode.demonstrations[supplied[0][0]], supplied[0][1]] : null;
    this.map.show(step, source);
    this.memory.replaceChildren(...this.supplied(step, supplied));
  }

  supplied(step, supplied) {
    const { h } = memtransfer;
    const { episode, run } = this;
    const stale = h("span", { class: "stale" }, "stale");
    const link = (index, at) => h("button", { type: "button", class: "source", onclick: () => this.onSource(this, index, at || 0) },
      `${episode.demonstrations[index].title}${at === undefined ? "" : `, step ${at}`}`);
    if (supplied.length === 0) {
      if (step >= this.last) return [h("p", {}, "The episode is over.")];
      const known = episode.supplied.length > 0;
      if (episode.demonstrations.length === 0) return [h("p", {}, "This memory has no demonstrations.")];
      return [h("p", {}, known ? "Memory retrieved nothing for this step. It was built from:" : "The log has no sources for this memory. It was built from:"),
        h("ul", {}, episode.demonstrations.map((one, index) => h("li", {}, link(index), " ", one.stale && stale.cloneNode(true))))];
    }
    return supplied.map(([index, at, distance]) => {
      const one = episode.demonstrations[index];
      const next = run.actions[one.actions[at]];
      return h("div", { class: "item" },
        one.views[at] && h("img", { src: run.views + one.views[at], alt: `View of ${one.title}, step ${at}`, width: 120, height: 120 }),
        h("div", {}, h("p", {}, link(index, at), " ", one.stale && stale.cloneNode(true)),
          distance !== null && h("p", { class: "soft" }, `Distance: ${distance}.`),
          h("p", { class: "soft" }, next ? `There the next action is: ${next}.` : "There the demonstration ends."),
          one.episode && h("p", {}, h("a", { href: memtransfer.address({ page: "episode", run: memtransfer.runs.indexOf(run) + 1, key: one.episode, step: at }) }, "Open that episode"))));
    });
  }

  /** Since when it failed: step, class, sign, words. */
  points() {
    const { loops, unlikeSuccess, unlikeReference } = this.episode.points || {};
    const points = (loops || []).map(([from, to]) => [from, "loop", "↻", `in a loop until step ${to}`]);
    if (unlikeSuccess) points.push([unlikeSuccess[0], "unlike", "≠", "unlike a success of the same case"]);
    else if (typeof unlikeReference === "number") points.push([unlikeReference, "unlike", "≠", "unlike the reference"]);
    return points;
  }

  /** The moments worth a mark on the time line: step, class, sign, words. */
  moments() {
    const { episode } = this;
    const moments = [
      ...episode.subGoals.map((step) => [step, "sub-goal", "▲", "sub-goal complete"]),
      ...episode.visits.filter((visit) => !episode.subGoals.includes(visit.step)).map((visit) => [visit.step, "visit", "△", `stands before ${this.item(visit)}`]),
      ...episode.blockedMoves.map((step) => [step, "blocked", "×", "move blocked"]),
      ...[...episode.actions].flatMap((letter, at) => (letter === "?" ? [[at + 1, "unread", "?", "answer not readable"]] : [])),
    ];
    if (episode.conflictAt !== null) moments.push([episode.conflictAt, "closed", "■", this.conflict]);
    if (episode.failure) moments.push([episode.failure.step, "failed", "⚑", `failed: ${episode.failure.kind}`]);
    moments.push(...this.points());
    return moments.sort((a, b) => a[0] - b[0]);
  }

  /** The marks above the slider, and below them the demonstration that was retrieved at each step. */
  timeLine(last) {
    const { h } = memtransfer;
    const place = (element, step) => { element.style.setProperty("--at", String(last ? step / last : 0)); return element; };
    const marks = this.moments().map(([step, style, sign, words]) => place(h("span", { class: `moment ${style}`, title: `step ${step}: ${words}` }, sign), step));
    const retrieved = this.episode.supplied.flatMap((supplied, step) => (supplied.length === 0 ? [] :
      [place(h("span", { class: `retrieval demonstration-${supplied[0][0] % 6}${this.episode.demonstrations[supplied[0][0]].stale ? " is-stale" : ""}`,
        title: `step ${step}: ${this.episode.demonstrations[supplied[0][0]].title}, step ${supplied[0][1]}` }), step)]));
    return h("div", { class: "time-line", "aria-hidden": "true" }, h("div", { class: "moments" }, marks),
      retrieved.length > 0 && h("div", { class: "retrievals" }, retrieved));
  }

  heading(level) {
    const { h } = memtransfer;
    const { run, row, episode } = this;
    const { name, mark, style, meaning } = memtransfer.outcome(run, row.outcome);
    const condition = run.conditions[row.condition];
    return h("div", { class: "heading" },
      h(level, {}, level === "h1" ? episode.instruction : `${run.name} (${run.policy}): ${condition.name}`),
      h("p", {}, h("span", { class: `mark ${style}`, "aria-hidden": "true" }, mark), ` ${name}: ${meaning}. `,
        `${episode.steps} steps, the reference takes ${episode.reference}; ${episode.subGoals.length} of ${episode.required} sub-goals.`),
      level === "h1" && h("p", { class: "soft" }, `${run.cases[row.case].id}, ${run.cases[row.case].task}; ${row.place || `run ${row.repetition}`}; policy: ${run.policy}`),
      h("p", { class: "soft" }, `Memory: ${condition.label}; ${memtransfer.conditionParts(condition).map(([name, value]) => `${name}: ${value}`).join("; ")} (${condition.name}).`));
  }

  /** Since when it failed, in a sentence for each point; `step` makes a link to a step. */
  sinceWhen(step) {
    const { h, runs, episodes, episodeAddress } = memtransfer;
    const { run, row, episode } = this;
    const { lastProgress, loops, unlikeSuccess, unlikeReference } = episode.points;
    const met = episode.subGoals.length;
    const sentences = [met > 0 ? ["Last progress: sub-goal ", `${met} of ${episode.required} at `, step(lastProgress), "."] : ["Last progress: none."]];
    if (loops === null) sentences.push(["Loop: not recorded in this log."]);
    else if (loops.length === 0) sentences.push(["Loop: none of 20 steps or more."]);
    else sentences.push(["Loop: from ", step(loops[0][0]), ` to step ${loops[0][1]} it is only in states in which it was before`,
      loops.slice(1).map(([from, to]) => [", again from ", step(from), ` to step ${to}`]), "."]);
    const later = (at) => (lastProgress > at ? " It completed a sub-goal after that, so the reason is later." : "");
    if (unlikeSuccess) {
      const [at, key] = unlikeSuccess;
      const number = runs.indexOf(run) + 1;
      const other = episodes(run).find((one) => one.key === key);
      const name = other ? `${run.conditions[other.condition].name}, ${other.place || `run ${other.repetition}`}` : key;
      sentences.push(["First unlike a success: ", step(at), ".", later(at), " ",
        h("a", { href: episodeAddress(number, row, { run2: number, key2: key, step: at }) }, `Compare with ${name}, which parts from here at step ${at}`), "."]);
    } else if (unlikeReference === null) {
      sentences.push(["No episode of this case, start and route succeeded."]);
    } else {
      sentences.push(["No episode of this case, start and route succeeded. First unlike the reference: ", step(unlikeReference), ".", later(unlikeReference)]);
    }
    return sentences.map((sentence) => h("li", {}, sentence));
  }

  /** Why it failed, in a sentence with links to the steps. */
  story(go) {
    const { h } = memtransfer;
    const { episode } = this;
    const step = (number) => h("button", { type: "button", class: "step-link", onclick: () => go(number) }, `step ${number}`);
    const sentences = [];
    if (episode.led) {
      const { demonstration, from, enters } = episode.led;
      const one = episode.demonstrations[demonstration];
      const source = (text, at) => h("button", { type: "button", class: "step-link", onclick: () => this.onSource(this, demonstration, at) }, text);
      sentences.push(from === null
        ? h("p", {}, "The agent tried to enter the closed passage at ", step(episode.conflictAt), ". Memory was built from the ",
          source(one.title, Math.max(enters - 1, 0)), `, which uses that passage from its step ${enters} on.`)
        : h("p", {}, "The agent tried to enter the closed passage at ", step(episode.conflictAt), ". What memory supplied for that step leads into it: ",
          source(`step ${from} of the ${one.title}`, from), from === enters ? ", which is inside that passage." : `, which enters that passage at its step ${enters}.`));
    } else if (episode.conflictAt !== null) {
      sentences.push(h("p", {}, `The agent ${this.conflict} at `, step(episode.conflictAt), this.hasMap ? "; what memory supplied for that step does not lead into it." : "."));
    }
    if (episode.failure) {
      sentences.push(h("p", {}, h("b", {}, `Failed, ${episode.failure.kind}: `), `${episode.failure.meaning}, `, step(episode.failure.step), "."), h("ul", { class: "points" }, this.sinceWhen(step)));
    }
    if (episode.changes.length) {
      const since = episode.firstBlock ? "since the demonstrations" : "since the block before in this sequence";
      sentences.push(h("p", {}, `What has changed in the world ${since}: ${episode.changes.join("; ")}.`));
    }
    return sentences.length ? h("div", { class: "story" }, sentences) : null;
  }
};

/** The one or two episodes that the address `current` names. */
memtransfer.loadEpisodes = ({ run, key, run2, key2 }) => {
  async function load(number, name) {
    const run = memtransfer.runs[(Number(number) || 1) - 1];
    const row = run && memtransfer.episodes(run).find((episode) => episode.key === name);
    if (!row) throw new Error(`This run has no episode ${name}.`);
    return { run, row, episode: await memtransfer.load(`${run.folder}/episodes/${row.index}`) };
  }
  return Promise.all(key2 ? [load(run, key), load(run2, key2)] : [load(run, key)]);
};

/** Shows `episodes`, which `loadEpisodes` has loaded. */
memtransfer.episodePage = (current, episodes) => {
  const { h, runs, note, load, address, episodeAddress } = memtransfer;
  const views = episodes.map(({ run, row, episode }) => new memtransfer.EpisodeView(run, row, episode, openSource));
  const isPair = views.length === 2;
  const [main] = views;
  const last = Math.max(...views.map((view) => view.last));
  const divergence = isPair ? firstDifference(...views) : pointOf("unlike");
  const firstLoop = pointOf("loop");
  const asked = current.step === undefined ? null : Number(current.step);
  let step = Math.min(Math.max(asked ?? (isPair ? divergence ?? 0 : 0), 0), last) || 0;
  let timer = null;

  const slider = h("input", { type: "range", min: 0, max: last, value: step, "aria-label": "Step", oninput: (event) => go(Number(event.target.value)) });
  const label = h("output", { class: "step" });
  const spoken = h("p", { class: "hidden", "aria-live": "polite" });
  const play = h("button", { type: "button", class: "play", onclick: () => toggle() }, "Play");
  const source = h("section", { class: "source-panel", "aria-label": "Demonstration", hidden: true });
  const perStep = h("div", { class: "request" });
  const button = (name, text, to) => h("button", { type: "button", "aria-label": name, title: name, onclick: () => go(to()) }, text);
  const moments = [...new Set(views.flatMap((view) => view.moments().map(([at]) => at)))].sort((a, b) => a - b);
  const nextMoment = () => moments.find((at) => at > step) ?? last;
  const previousMoment = () => moments.filter((at) => at < step).pop() ?? 0;

  const pairing = { run2: current.run2, key2: current.key2 };
  const remember = (more) => note({ page: "episode", run: current.run || 1, key: current.key, ...pairing, step, ...more });
  let openDemonstration = {};

  function go(wanted, quietly) {
    step = Math.min(Math.max(wanted, 0), last);
    slider.value = step;
    slider.setAttribute("aria-valuetext", `step ${step} of ${last}`);
    label.textContent = `Step ${step} of ${last}`;
    for (const view of views) view.show(step);
    if (!isPair) showRequest();
    if (!quietly && !timer) spoken.textContent = `Step ${step}. ${views.map((view) => view.words(Math.min(step, view.last))).join(" Beside it: ")}`;
    if (prompts && prompts.open) showPrompt();
    remember(openDemonstration);
  }

  function toggle() {
    if (timer) { clearInterval(timer); timer = null; play.textContent = "Play"; return; }
    if (step >= last) go(0);
    play.textContent = "Pause";
    timer = setInterval(() => { if (step >= last) toggle(); else go(step + 1); }, 250);
  }

  /** Opens the demonstration that an item comes from, at its step. */
  function openSource(view, index, at) {
    const one = view.episode.demonstrations[index];
    const { run } = view;
    const images = h("ol", { class: "film" });
    const map = new memtransfer.EpisodeMap(run, view.episode);
    const range = h("input", { type: "range", min: 0, max: one.poses.length - 1, value: at, "aria-label": "Step of the demonstration", oninput: (event) => show(Number(event.target.value)) });
    const caption = h("output", { class: "step" });
    function show(now) {
      range.value = now;
      caption.textContent = `Step ${now} of ${one.poses.length - 1}`;
      map.show(Math.min(step, view.last), [one, now]);
      images.replaceChildren(...[0, 1, 2, 3, 4, 5].map((ahead) => now + ahead).filter((t) => t < one.poses.length).map((t) => h("li", {},
        one.views[t] && h("img", { src: run.views + one.views[t], alt: `View at step ${t} of the demonstration`, width: 160, height: 160 }),
        h("span", {}, `${t}. ${run.actions[one.actions[t]] || "end"}`))));
      openDemonstration = { demonstration: index, at: now, side: views.indexOf(view) || "" };
      remember(openDemonstration);
    }
    source.replaceChildren(h("h2", {}, one.title, " ", one.stale && h("span", { class: "stale" }, "stale")),
      h("p", { class: "soft" }, one.stale ? "Replayed in the world of this episode, it does not complete its task." : "Replayed in the world of this episode, it completes its task."),
      h("div", { class: "controls" }, range, caption,
        h("button", { type: "button", onclick: () => { source.hidden = true; openDemonstration = {}; remember({}); } }, "Close")),
      images, map.element);
    source.hidden = false;
    show(Math.min(at, one.poses.length - 1));
    source.scrollIntoView({ block: "nearest" });
  }

  function showRequest() {
    const request = main.episode.requests.filter((one) => one.step === step).pop();
    perStep.replaceChildren(...(request ? [facts([["Outcome", request.outcome],
      ["Latency", request.latencyUs === null ? null : `${(request.latencyUs / 1000).toFixed(1)} ms`], ["Images", request.images],
      ["Prompt tokens", request.promptTokens], ["Answer tokens", request.completionTokens], ["Memory tokens, estimated", request.memoryTokens],
      ["Attempts", request.attempts], ["From the cache", request.replayed ? "yes" : null]])] : []));
  }

  const facts = (entries) => h("dl", { class: "facts" }, entries.filter(([, value]) => value !== null && value !== undefined)
    .map(([name, value]) => h("div", {}, h("dt", {}, name), h("dd", {}, String(value)))));

  const promptBody = h("div", {});
  const prompts = !isPair && main.episode.prompts ? h("details", { class: "prompts", open: current.prompt === "1", ontoggle: () => { if (prompts.open) showPrompt(); } },
    h("summary", {}, "Prompt and reply, word for word"), promptBody) : null;

  async function showPrompt() {
    const logged = await load(`${main.run.folder}/prompts/${main.row.index}`);
    const prompt = logged.find((one) => one.step === step);
    if (!prompt) { promptBody.replaceChildren(h("p", {}, "The log has no prompt of this step.")); return; }
    const picture = ({ image, caption }) => h("figure", {}, image && h("img", { src: `${main.run.folder}/images/${image}.jpg`, alt: caption || "View", width: 160, height: 160, loading: "lazy" }), h("figcaption", {}, caption));
    const row = (images) => h("div", { class: "film" }, images.map(picture));
    promptBody.replaceChildren(
      facts(prompt.facts),
      ...(prompt.hinted ? [h("p", {}, "The prompt says that a demonstration started where this episode did.")] : []),
      h("h3", {}, "Window of past steps"), prompt.window.length ? row(prompt.window) : h("p", {}, "Empty."),
      h("h3", {}, "Memory"), ...(prompt.items.length ? prompt.items.map((item) => h("div", {}, h("h4", {}, item.title), item.text !== null && h("pre", {}, item.text), row(item.images))) : [h("p", {}, "Nothing.")]),
      ...prompt.messages.flatMap((message) => [h("h3", {}, `Message of role ${message.role}`),
        ...message.parts.map((part) => ("text" in part ? h("pre", {}, part.text) : picture({ image: part.image, caption: "" })))]),
      ...(prompt.reply === null && prompt.messages.length === 0 ? [] : [h("h3", {}, "Reply"), h("pre", {}, prompt.reply === null ? "(none)" : prompt.reply)]),
      prompt.unread !== null ? h("p", {}, `No action could be read in it: ${prompt.unread}`) : "");
  }

  function compare() {
    const options = runs.flatMap((run, number) => memtransfer.episodes(run)
      .filter((one) => run.cases[one.case].id === main.run.cases[main.row.case].id && (one.key !== main.row.key || run !== main.run))
      .map((one) => [`${number + 1} ${one.key}`, `${runs.length > 1 ? `${run.name}: ` : ""}${run.conditions[one.condition].name}, ${one.place || `run ${one.repetition}`}: ${memtransfer.outcome(run, one.outcome).name}`]));
    const chosen = current.key2 ? `${current.run2 || 1} ${current.key2}` : "";
    return options.length > 0 && h("label", { class: "compare" }, "Side by side with",
      h("select", { onchange: (event) => {
        const [number, ...key] = event.target.value.split(" ");
        location.hash = episodeAddress(current.run || 1, main.row, key.length ? { run2: number, key2: key.join(" ") } : { step });
      } }, h("option", { value: "" }, "nothing"), options.map(([value, text]) => h("option", { value, selected: value === chosen }, text))));
  }

  const controls = h("div", { class: "controls" },
    button("First step (Home)", "|◂", () => 0), button("Previous mark (p)", "◂◂", previousMoment), button("Step back (left arrow)", "◂", () => step - 1),
    play, button("Step on (right arrow)", "▸", () => step + 1), button("Next mark (n)", "▸▸", nextMoment), button("Last step (End)", "▸|", () => last), label);
  const back = h("nav", { "aria-label": "Path" }, h("a", { href: memtransfer.grids[current.run || 1] || address({ run: runs.length > 1 ? current.run || 1 : "" }) }, `← ${main.run.name}`));
  const title = `${main.run.cases[main.row.case].id}, ${main.run.conditions[main.row.condition].name}`;
  const signs = h("p", { class: "signs" }, main.hasMap ? "▲ sub-goal  △ arrival before an item  × blocked  ■ closed passage  ? unreadable  ↻ loop  ≠ unlike a success  ⚑ failed"
    : "▲ sub-goal  ■ ran into what blocks the way  ? unreadable  ↻ loop  ≠ unlike a success  ⚑ failed");
  const transport = [views.map((view) => h("div", { class: "line" }, isPair && h("span", { class: "hidden" }, view.run.name), view.timeLine(last))), slider, controls, signs, spoken];

  const legend = main.hasMap && memtransfer.EpisodeMap.legend(episodes.map(({ episode }) => episode));

  if (isPair) {
    const words = divergence === null ? "Both act alike to the end." : divergenceWords(views, divergence);
    memtransfer.page(`${title} and another`, back,
      h("header", {}, h("h1", {}, main.episode.instruction), h("p", { class: "soft" }, `Case ${main.run.cases[main.row.case].id}. The first is on the left, the second on the right.`), compare(),
        h("p", { class: "divergence" }, words, " ", divergence !== null && h("button", { type: "button", class: "step-link", onclick: () => go(divergence) }, `Go to step ${divergence}`))),
      h("section", { class: "transport", "aria-label": "Time" }, transport), legend,
      h("div", { class: "pair" }, views.map((view) => h("section", { "aria-label": `${view.run.name}, ${view.run.conditions[view.row.condition].name}` },
        view.heading("h2"), view.story(go) || h("div", {}), h("div", { class: "sight" }, view.camera, view.map.element),
        h("div", {}, h("h3", {}, "Memory at this step"), view.memory)))),
      source);
  } else {
    memtransfer.page(title, back, h("header", {}, main.heading("h1"), compare()), main.story(go),
      h("div", { class: "stage" },
        h("div", {}, main.camera, h("section", { class: "transport", "aria-label": "Time" }, transport),
          h("section", { "aria-label": "Memory" }, h("h2", {}, "Memory at this step"), main.memory), perStep),
        main.hasMap && h("section", { "aria-label": "Map" }, legend, main.map.element)),
      source, prompts,
      h("details", {}, h("summary", {}, "Counts and times of the episode"), facts(main.episode.facts),
        main.episode.stages.length > 0 && [h("h3", {}, "Mean time of a step by stage"), facts(main.episode.stages.map(([name, us]) => [name, `${us} µs`]))]));
  }
  go(step, true);
  if (current.demonstration !== undefined) {
    const view = views[Number(current.side) || 0];
    if (view && view.episode.demonstrations[Number(current.demonstration)]) openSource(view, Number(current.demonstration), Number(current.at) || 0);
  }

  function keys(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.closest("select, input, textarea, summary")) return;
    if (event.key === " " && event.target.closest("button, a")) return;
    const steps = { ArrowRight: () => step + 1, ArrowLeft: () => step - 1, Home: () => 0, End: () => last, n: nextMoment, p: previousMoment };
    if (event.key === " ") toggle();
    else if (event.key === "f" && main.episode.failure) go(main.episode.failure.step);
    else if (event.key === "d" && divergence !== null) go(divergence);
    else if (event.key === "l" && firstLoop !== null) go(firstLoop);
    else if (steps[event.key]) go(steps[event.key]());
    else return;
    event.preventDefault();
  }
  document.addEventListener("keydown", keys);
  return () => { document.removeEventListener("keydown", keys); clearInterval(timer); };

  /** The first step of this class since which the episode failed; `null` if there is none. */
  function pointOf(style) {
    const point = main.points().find((one) => one[1] === style);
    return point ? point[0] : null;
  }

  /** The first step after which the two do not do the same; `null` if there is none. */
  function firstDifference(a, b) {
    const [one, other] = [a.episode, b.episode];
    const length = Math.max(one.actions.length, other.actions.length);
    for (let at = 0; at < length; at += 1) {
      if (one.states[at] !== other.states[at] || one.actions[at] !== other.actions[at]) return at;
    }
    return null;
  }

  function divergenceWords([a, b], at) {
    const next = (view) => (at < view.last ? view.action(at + 1) : "nothing more");
    if (at === 0 && a.episode.states[0] !== b.episode.states[0]) return `They start in different ${a.hasMap ? "poses" : "states"}.`;
    return `They act alike until step ${at}. Then the first does: ${next(a)}; the second: ${next(b)}.`;
  }
};
