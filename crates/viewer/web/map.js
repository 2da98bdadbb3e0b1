// The map of an episode: the floor with its items, and what happened on it up to a step.
"use strict";

memtransfer.EpisodeMap = class {
  constructor(run, episode) {
    const { h } = memtransfer;
    const [cell, margin, columns, rows] = run.map;
    Object.assign(this, { run, episode, cell, margin, columns, rows });
    const [width, height] = [2 * margin + columns * cell, 2 * margin + rows * cell];
    this.layers = {};
    const layers = ["seen", "targets", "closed", "reference", "demonstration", "path", "marks", "agent"];
    this.drawing = h("svg", { class: "map-drawing", viewBox: `0 0 ${width} ${height}`, role: "img" },
      layers.map((name) => (this.layers[name] = h("g", { class: `map-${name}` }))));
    if (columns === 0) {
      this.element = h("p", { hidden: true });
      return;
    }
    this.element = h("div", { class: "map" },
      h("img", { src: `${run.folder}/maps/${episode.ground}.svg`, alt: "", width, height }), this.drawing);
    this.fixed();
  }

  x(column) { return this.margin + (column + 0.5) * this.cell; }
  y(row) { return this.margin + (this.rows - row - 0.5) * this.cell; }
  point([column, row]) { return `${this.x(column)},${this.y(row)}`; }
  square([column, row], inset, attributes) {
    const size = this.cell - 2 * inset;
    return memtransfer.h("rect", { x: this.x(column) - size / 2, y: this.y(row) - size / 2, width: size, height: size, ...attributes });
  }

  /** What does not change with the step. */
  fixed() {
    const { h } = memtransfer;
    const { episode } = this;
    this.layers.reference.append(h("polyline", { points: episode.referencePath.map((cell) => this.point(cell)).join(" ") }));
    for (const cell of episode.closed) {
      const [x, y, half] = [this.x(cell[0]), this.y(cell[1]), this.cell / 2 - 5];
      this.layers.closed.append(this.square(cell, 3, { rx: 3 }),
        h("path", { d: `M${x - half} ${y - half}L${x + half} ${y + half}M${x + half} ${y - half}L${x - half} ${y + half}` }));
    }
  }

  /** Shows the episode after `step` steps; `source` is a demonstration and a step in it, or nothing. */
  show(step, source) {
    if (this.columns === 0) return;
    const { h } = memtransfer;
    const { episode, layers } = this;
    const poses = episode.poses.slice(0, step + 1);
    const seen = episode.seen.slice(0, step + 1).flat();
    const half = this.cell / 2;
    const seenPath = seen.map((index) => {
      const [column, row] = [index % this.columns, Math.floor(index / this.columns)];
      return `M${this.x(column) - half} ${this.y(row) - half}h${this.cell}v${this.cell}h${-this.cell}Z`;
    });
    layers.seen.replaceChildren(h("path", { d: seenPath.join("") }));
    const reached = new Set(episode.visits.filter((visit) => visit.step <= step).map((visit) => visit.cell.join()));
    layers.targets.replaceChildren(...episode.targets.flatMap(({ letter, name, cell }) => {
      const isReached = reached.has(cell.join());
      return [this.square(cell, 4, { class: isReached ? "reached" : "open", rx: 8 }),
        h("text", { x: this.x(cell[0]), y: this.y(cell[1]) + 6 }, isReached ? `${letter}✓` : letter, h("title", {}, name))];
    }));
    layers.path.replaceChildren(h("polyline", { points: poses.map((pose) => this.point(pose)).join(" ") }));
    const blocked = episode.blockedMoves.filter((at) => at <= step);
    layers.marks.replaceChildren(...blocked.map((at) => {
      const [x, y] = poses[at];
      const [cx, cy] = [this.x(x), this.y(y)];
      return h("path", { d: `M${cx - 7} ${cy - 7}l14 14M${cx + 7} ${cy - 7}l-14 14` });
    }));
    layers.demonstration.replaceChildren(...(source ? this.demonstration(source) : []));
    const [x, y, heading] = poses[poses.length - 1];
    layers.agent.replaceChildren(this.arrow([x, y, heading], "agent"));
    this.drawing.setAttribute("aria-label", `Map. After step ${step} the agent is in column ${x}, row ${y}, facing ${memtransfer.HEADINGS[heading]}. ` +
      `${seen.length} cells were in view, ${reached.size} of ${episode.targets.length} target cells were reached.`);
  }

  demonstration([demonstration, at]) {
    const { h } = memtransfer;
    if (demonstration.elsewhere) return [];
    const poses = demonstration.poses;
    return [h("polyline", { points: poses.map((pose) => this.point(pose)).join(" ") }), poses[at] && this.arrow(poses[at], "source")].filter(Boolean);
  }

  arrow([x, y, heading], style) {
    const { h } = memtransfer;
    return h("path", { class: style, d: "M0 -17L12 14L0 7L-12 14Z", transform: `translate(${this.x(x)} ${this.y(y)}) rotate(${heading * 90})` });
  }

  /** The legend of the maps of `episodes`, which have the same case. */
  static legend(episodes) {
    const { h } = memtransfer;
    const entry = (style, text, sign) => h("li", {}, h("span", { class: `swatch ${style}`, "aria-hidden": "true" }, sign), text);
    const names = new Map();
    for (const { letter, name } of episodes.flatMap((episode) => episode.targets)) names.set(letter, (names.get(letter) || new Set()).add(name));
    const targets = [...names].sort().map(([letter, ofLetter]) => entry("target", `${letter}: ${[...ofLetter].join(", ")}`, letter));
    return h("ul", { class: "legend" }, entry("path", "walked"), entry("reference", "reference"), entry("seen", "seen so far"), targets,
      targets.length > 0 && entry("reached", "reached", "✓"), episodes.some(({ closed }) => closed.length > 0) && entry("closed", "closed passage"),
      episodes.some(({ demonstrations }) => demonstrations.length > 0) && entry("demonstration", "demonstration"), entry("blocked", "blocked move"));
  }
};

memtransfer.HEADINGS = ["north", "east", "south", "west"];
