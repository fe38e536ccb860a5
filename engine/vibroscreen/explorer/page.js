"use strict";
// What the page does: it hands numbers to the engine and draws what comes back. The engine decides
// what is refused, and computes all figures; offsets, names, limits and texts come with the page.
const SCREEN = JSON.parse(document.getElementById("screen").textContent);
const { commands: DO, controls: CONTROLS } = SCREEN;
const byId = (id) => document.getElementById(id);
const count = SCREEN.panels.length;

// --- texts, as Python writes them ---------------------------------------------------------------
function general(x, digits) {
  // Python's format(x, ".6g").
  if (!Number.isFinite(x)) return Number.isNaN(x) ? "nan" : x > 0 ? "inf" : "-inf";
  if (x === 0) return Object.is(x, -0) ? "-0" : "0";
  const [mantissa, power] = x.toExponential(digits - 1).split("e");
  const plain = (text) => (text.includes(".") ? text.replace(/\.?0+$/, "") : text);
  if (power >= -4 && power < digits) return plain(x.toFixed(Math.max(0, digits - 1 - power)));
  return `${plain(mantissa)}e${power[0]}${power.slice(1).padStart(2, "0")}`;
}

function told(key, about) {
  return filled(SCREEN.texts[key], about);
}

function filled(text, about) {
  return text.replace(/\{(\w+)(?::\.(\d+)g)?\}/g, (_, name, digits) =>
    digits ? general(about[name], Number(digits)) : about[name]);
}

// --- the engine ---------------------------------------------------------------------------------
async function unpacked(text) {
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const plain = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Response(plain).arrayBuffer();
}

class Buffer {
  // A screen in the memory of the engine; names and offsets as in kernels/state.py.
  constructor(engine, about, place, head) {
    Object.assign(this, { engine, about, place });
    this.numbers = new Float64Array(engine.memory.buffer, place, about.size);
    this.numbers.set(new Float64Array(head));
    this.settings = this.numbers.subarray(...about.settings);
  }
  run(command, first = 0, second = 0) {
    const size = BigInt(this.about.size);
    return Number(this.engine.vibroscreen_run(this.place, size, BigInt(command), first, second));
  }
  extent(name) {
    return this.numbers[this.about.dimension[name][0]];
  }
  view(name, size, row = 0) {
    const start = this.about.at[name] + row * size;
    return this.numbers.subarray(start, start + size);
  }
  record(name, row = 0) {
    const names = SCREEN.records[name];
    const values = this.view(name, names.length, row);
    return Object.fromEntries(names.map((one, k) => [one, values[k]]));
  }
  ofNodes(name, row = 0) {
    return this.view(name, this.extent("nodes"), row);
  }
  scene(deck, panel) {
    return this.record("scene", deck * this.extent("panels") + panel);
  }
}

let steady, running, scratch; // two buffers, and room for a few numbers
let wanted; // parameters and inputs as the fields say them
let accepted; // those that the running screen has

async function start() {
  const [code, ...heads] = await Promise.all(
    [SCREEN.engine, SCREEN.steady.head, SCREEN.running.head].map(unpacked));
  const { exports: engine } = (await WebAssembly.instantiate(code)).instance;
  const page = 65536;
  let place = Math.ceil(engine.__heap_base.value / 64) * 64;
  const places = [SCREEN.steady.size, SCREEN.running.size, 128 + SCREEN.bed.work].map((size) => {
    const here = place;
    place += Math.ceil(size / 8) * 64;
    return here;
  });
  engine.memory.grow(Math.max(0, Math.ceil((place - engine.memory.buffer.byteLength) / page)));
  steady = new Buffer(engine, SCREEN.steady, places[0], heads[0]);
  running = new Buffer(engine, SCREEN.running, places[1], heads[1]);
  scratch = { place: places[2], numbers: new Float64Array(engine.memory.buffer, places[2]) };
  wanted = steady.settings.slice();
}

function at(name, field, row = 0) {
  // Place of a number among the settings.
  const names = SCREEN.records[name];
  const start = SCREEN.steady.at[name] - SCREEN.steady.settings[0];
  return start + row * names.length + names.indexOf(field);
}

function panelAt(field, deck, panel) {
  return at("panel", field, deck * Math.max(...SCREEN.panels) + panel);
}

function followTable() {
  // The velocity through the openings is that of a table at each aperture; null or what is wrong.
  if (!SCREEN.table) return null;
  const sizes = SCREEN.table.map((row) => row[0]);
  const speeds = SCREEN.table.map((row) => row[1]);
  const last = sizes.length - 1;
  let first = null;
  for (let deck = 0; deck < count; deck++) {
    for (let panel = 0; panel < SCREEN.panels[deck]; panel++) {
      const index = panelAt("aperture", deck, panel);
      const aperture = wanted[index];
      if (!(aperture >= sizes[0] && aperture <= sizes[last])) {
        const end = aperture < sizes[0] ? sizes[0] : sizes[last];
        return { index, text: message("off_table", index, aperture, end) };
      }
      let k = 0;
      while (k + 1 < last && sizes[k + 1] <= aperture) k++;
      const slope = (speeds[k + 1] - speeds[k]) / (sizes[k + 1] - sizes[k]);
      const speed = aperture === sizes[last] ? speeds[last] : slope * (aperture - sizes[k]) + speeds[k];
      first ??= speed;
      const factor = first === 0 ? 1 : speed / first;
      const row = deck * Math.max(...SCREEN.panels) + panel;
      for (const buffer of [steady, running]) buffer.view("passage_factor", 1, row)[0] = factor;
    }
  }
  wanted[at("parameter", "passage_velocity")] = first;
  return null;
}

// --- what is refused ----------------------------------------------------------------------------
function message(key, index, value, bound) {
  // As Python tells it of a file: names and units of its keys.
  const said = SCREEN.settings[index];
  const control = CONTROLS.find((one) => one.place === index);
  const shown = control?.typed?.value * said.factor === value ? control.typed.value : value / said.factor;
  const degrees = (value * 180) / Math.PI;
  const about = {
    name: said.name, given: `${said.name} = ${general(shown, 6)}`, value: shown, unit: said.unit,
    range: said.range, cure: cure(key, said, value, shown), number: wanted[index],
    limit: key === "too_steep" ? bound : bound / said.factor, degrees, slope: Math.tan(value),
  };
  return told(key, about);
}

function cure(key, said, value, shown) {
  const far = Math.abs(value) > SCREEN.far * Math.max(Math.abs(said.least), Math.abs(said.most)) ||
    value < said.least / SCREEN.far;
  if ((key === "too_small" || key === "too_large") && far) {
    for (const unit of said.others) {
      const meant = shown * unit.factor;
      if (meant >= said.least && meant <= said.most)
        return filled(unit.question, { value: shown, meant: meant / said.factor });
    }
  }
  return said.cure;
}

function refusal(buffer, row) {
  const [code, place, value, limit] = row;
  const key = SCREEN.refused[code - 1];
  const index = place - buffer.about.settings[0];
  if (key === "no_conveying") return { index, text: notConveyed() };
  if (key === "bad_sum") return { index: -1, text: told(key, { value, limit }) };
  return { index, text: message(key, index, value, limit) };
}

function notConveyed() {
  const of = (name, field, row) => wanted[at(name, field, row)];
  const prescribed = of("parameter", "displacement_model") === 1;
  if (prescribed && of("input", "displacement_velocity") === 0) return told("no_bed_velocity");
  const [frequency, amplitude] = ["motion_frequency", "motion_amplitude"].map((n) => at("input", n));
  const moves = wanted[frequency] > 0 &&
    (wanted[amplitude] !== 0 || steady.view("harmonic", 20).some((x) => x !== 0));
  for (let deck = 0; moves && deck < count; deck++) {
    for (let panel = 0; panel < SCREEN.panels[deck]; panel++) {
      if (wanted[panelAt("velocity_factor", deck, panel)] !== 0) continue;
      return told("still_panel", { name: `deck[${deck + 1}].panel[${panel + 1}].velocity_factor` });
    }
  }
  let why = "", help = "";
  if (moves && of("parameter", "displacement_model") === 2) {
    const [rigid, grains] = ["rigid_body", "solve_bed"].map(velocity);
    if (rigid <= 0) {
      const slope = wanted[panelAt("inclination", 0, 0)];
      why = told("body_stays", { degrees: (slope * 180) / Math.PI, value: rigid });
      help = grains > 0 ? told("grains_ride", { value: grains }) : "";
    }
  }
  const given = (index) => {
    const { name, factor } = SCREEN.settings[index];
    return `${name} = ${general(wanted[index] / factor, 6)}`;
  };
  return told("no_conveying", { given: given(frequency), other: given(amplitude), why, cure: help });
}

function velocity(model) {
  // Velocity of a body, or of grains, on the first panel, m/s: by the engine's own entries.
  const { engine } = steady;
  const { numbers, place } = scratch;
  const [motion, parts, rows, drive, result, work] = [0, 8, 32, 64, 72, 80];
  const of = (field) => wanted[at("parameter", field)];
  const friction = Math.min(of("material_friction_deck"), of("material_friction_internal"));
  const inputs = SCREEN.records.input.filter((name) => name.startsWith("motion_"));
  numbers.fill(0, 0, 128 + SCREEN.bed.work);
  numbers.set(inputs.map((name) => wanted[at("input", name)]), motion);
  numbers.set(steady.view("harmonic", 20), parts);
  numbers.set([numbers[motion], wanted[panelAt("inclination", 0, 0)], friction], drive);
  numbers.set(SCREEN.bed.constants, work + SCREEN.bed.place);
  const vector = (where, size) => [place + 8 * where, BigInt(size)];
  const rowsOf = (where, size) => [...vector(where, size), 5n];
  engine.vibroscreen_compose_motion(...vector(motion, 4), ...rowsOf(parts, 4), 0, ...rowsOf(rows, 5));
  engine[`vibroscreen_${model}`](
    ...rowsOf(rows, 5), ...vector(drive, 5), ...vector(result, 7), ...vector(work, SCREEN.bed.work));
  return numbers[result];
}

// --- what comes back ----------------------------------------------------------------------------
const cumulative = (values) => values.reduce((sums, x) => [...sums, sums.at(-1) + x], [0]);
const sum = (values) => values.reduce((total, x) => total + x, 0);
const points = SCREEN.points;

function solve() {
  // Steady state under `wanted`, or what is wrong with it.
  const fault = followTable();
  if (fault) return { fault };
  steady.view("design", wanted.length).set(wanted);
  steady.view("design_harmonic", 20).set(steady.view("harmonic", 20));
  steady.run(DO.SOLVE_MANY, 1, 1);
  const row = steady.view("design_result", 4);
  if (row[0]) return { fault: refusal(steady, row) };
  const seen = read(steady);
  march(seen);
  return { seen };
}

function read(buffer) {
  // Figures, streams and partition; `bed` of each deck is still to be filled.
  const output = buffer.record("output");
  const classes = SCREEN.edges.length - 1;
  const stream = (name, rate, fraction, about) => ({ name, rate, passing: cumulative([...fraction]), ...about });
  const fed = wantedFeed();
  const products = [stream("feed", fed.rate, fed.fraction, {})];
  const { undersize_p80: p80, undersize_p50: p50 } = output;
  products.push(stream("undersize", output.undersize_rate, buffer.view("undersize_fraction", classes), { p80, p50 }));
  for (let k = count - 2; k >= 0; k--) {
    const between = buffer.record("intermediate", k);
    const fraction = buffer.view("intermediate_fraction", classes, k);
    products.push(stream(`over deck ${k + 2}`, between.rate, fraction, between));
  }
  const over = { p80: output.oversize_p80, p50: output.oversize_p50 };
  products.push(stream("oversize", output.oversize_rate, buffer.view("oversize_fraction", classes), over));
  const size = buffer.ofNodes("size");
  const decks = SCREEN.panels.map((_, deck) => {
    const figures = buffer.record("deck_result", deck);
    const under = buffer.ofNodes("step_mass", deck), left = buffer.ofNodes("step_mass", count + deck);
    const come = deck ? buffer.ofNodes("step_mass", deck - 1) : buffer.ofNodes("feed_fraction");
    const fine = sum(Array.from(size, (d, i) => (d < figures.aperture ? come[i] : 0)));
    const there = [...size.keys()].filter((i) => under[i] + left[i] > 0);
    const partition = [there.map((i) => size[i] * 1e3), there.map((i) => (100 * left[i]) / (under[i] + left[i]))];
    return { figures, partition, fine: deck ? fine : fine * fed.rate };
  });
  return { output, products, decks, alarms: alarms(buffer) };
}

function wantedFeed() {
  const start = SCREEN.settings.findIndex((one) => one?.name === "feed.mass_fraction[1]");
  return { rate: wanted[at("input", "feed_mass_flow_rate")], start,
    fraction: wanted.subarray(start, start + SCREEN.edges.length - 1) };
}

function alarms(buffer) {
  return SCREEN.alarms.flatMap((name, k) => {
    const { reason, deck, value, limit, other } = buffer.record("alarm", k);
    if (!(reason > 0)) return [];
    const about = { number: deck, value, limit, other_limit: other, degrees: (value * 180) / Math.PI, slope: Math.tan(value) };
    return [`${name}: ${told(SCREEN.reasons[reason - 1], about)}`];
  });
}

function layersOf(buffer, name, row, aperture) {
  // What lies at a place: depth, and content of the chosen size by layer.
  const nodes = buffer.extent("nodes"), layers = buffer.extent("layers");
  const load = buffer.view(name, nodes * layers, row), size = buffer.ofNodes("size");
  const density = wanted[at("parameter", "material_bulk_density")];
  const chosen = Number(byId("map-size").value);
  const [low, high] = chosen < 0 ? [0, aperture] : SCREEN.edges.slice(chosen, chosen + 2);
  const inside = Array.from(size, (d) => d >= low && d < high);
  const found = [];
  for (let j = 0; j < layers; j++) {
    let whole = 0, part = 0;
    for (let i = 0; i < nodes; i++) {
      const mass = load[j * nodes + i];
      whole += mass;
      if (inside[i]) part += mass;
    }
    if (whole > 0) found.push([whole / density, part / whole]);
  }
  return found;
}

const placesOf = (deck) => {
  const length = sum(SCREEN.lengths[deck]);
  return Array.from({ length: points }, (_, k) => (length * k) / (points - 1));
};

function march(seen) {
  // Follow the slice of each deck from the feed end to the discharge, as Python's profiles do.
  const width = SCREEN.panels.map((_, deck) => wanted[SCREEN.settings.findIndex((one) => one?.name === `deck[${deck + 1}].width_m`)]);
  steady.run(DO.START_SLICE);
  seen.decks.forEach((deck, d) => {
    if (d) steady.run(DO.START_BELOW, d);
    const speeds = SCREEN.lengths[d].map((_, p) => steady.scene(d, p).transport_velocity);
    const ends = cumulative(SCREEN.lengths[d]);
    const times = cumulative(SCREEN.lengths[d].map((length, p) => length / speeds[p]));
    const size = steady.ofNodes("size");
    let before = 0;
    deck.bed = [];
    deck.recovery = [placesOf(d), []];
    for (const place of placesOf(d)) {
      let panel = 0;
      while (panel + 1 < speeds.length && place > ends[panel + 1]) panel++;
      const moment = times[panel] + (place - ends[panel]) / speeds[panel];
      if (moment > before) steady.run(DO.FOLLOW, moment - before, d);
      before = moment;
      const passed = steady.ofNodes("lead_passed", d);
      const fine = sum(Array.from(size, (s, i) => (s < deck.figures.aperture ? passed[i] : 0)));
      deck.recovery[1].push(Math.min(100, (100 * fine * width[d] * speeds[0]) / deck.fine));
      deck.bed.push(layersOf(steady, "lead", d, deck.figures.aperture));
    }
  });
}

// --- a screen that runs -------------------------------------------------------------------------
let clock = 0, history = [];

function restart() {
  // Begin anew with `wanted`; what is wrong with it, or null.
  const fault = followTable();
  if (fault) return fault;
  const { outputs, state } = SCREEN.running;
  running.settings.set(wanted);
  if (!running.run(DO.CHECK)) {
    running.run(DO.PLACE_NODES);
    running.numbers.fill(0, ...outputs);
    running.numbers.fill(0, ...state);
  }
  if (running.run(DO.CHECK) || running.run(DO.INITIALISE)) return refusal(running, running.view("refusal", 4));
  accepted = wanted.slice();
  [clock, history] = [0, []];
  return null;
}

function advance(duration) {
  // Let time go on; a change that is refused is told and left out.
  const fault = followTable();
  let refused = fault;
  if (!fault) {
    running.settings.set(wanted);
    if (!running.run(DO.ADVANCE, duration)) accepted = wanted.slice();
    else refused = refusal(running, running.view("refusal", 4));
  }
  if (refused) {
    running.settings.set(accepted);
    running.run(DO.ADVANCE, duration);
  }
  running.run(DO.READ);
  clock += duration;
  return refused;
}

function watch() {
  const seen = read(running);
  seen.decks.forEach((deck, d) => {
    deck.bed = placesOf(d).map((place) => {
      running.run(DO.READ_BED, place, d);
      return layersOf(running, "column", 0, deck.figures.aperture);
    });
    deck.recovery = [[], []];
  });
  history.push([clock, ...seen.products.map((one) => one.rate * 3.6)]);
  if (history.length > 600) history = history.slice(-500);
  seen.time = [history.map((row) => row[0]), ...seen.products.map((_, k) => history.map((row) => row[k + 1]))];
  return seen;
}
