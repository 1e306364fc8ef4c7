// The map: the net drawn once into a picture, and what moves over it, from where a tick left it.

const COLOURS = ["road", "junction", "walk", "grass", "house", "water", "mark", "car", "two", "person", "ego", "route", "ink", "card", "good", "bad"];
const LIGHTS = { r: "#e5342b", u: "#e5342b", y: "#f0b400", Y: "#f0b400", g: "#27b463", G: "#27b463", s: "#e5342b" };

export class StreetMap {
  constructor(canvas, scale, onView, onPick) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
    this.scaleBar = scale;
    this.onView = onView;
    this.onPick = onPick;
    this.centre = [0, 0];
    this.zoom = 4;
    this.follow = true;
    this.turn = false;
    this.angle = 0;
    this.trail = [];
    this.route = null;
    this.net = null;
    this.state = null;
    this.still = document.createElement("canvas");
    this.stillOf = null;
    this.calm = matchMedia("(prefers-reduced-motion: reduce)");
    this.recolour();
    this.listen();
    new ResizeObserver(() => { this.stillOf = null; this.draw(true); }).observe(canvas);
  }

  recolour() {
    const style = getComputedStyle(document.documentElement);
    this.colour = Object.fromEntries(COLOURS.map((name) => [name, style.getPropertyValue("--" + name).trim()]));
    this.stillOf = null;
  }

  setNet(net) {
    const path = (flat, closed) => {
      const p = new Path2D();
      for (let i = 0; i + 1 < flat.length; i += 2) i ? p.lineTo(flat[i], flat[i + 1]) : p.moveTo(flat[i], flat[i + 1]);
      if (closed) p.closePath();
      return p;
    };
    const lanes = new Map();
    for (const [kind, width, ...flat] of net.lanes) {
      const key = kind + ":" + width;
      if (!lanes.has(key)) lanes.set(key, { kind, width, path: new Path2D() });
      lanes.get(key).path.addPath(path(flat));
    }
    const areas = { house: new Path2D(), green: new Path2D(), water: new Path2D() };
    for (const [kind, flat] of net.areas) {
      const sort = /water|river|lake/.test(kind) ? "water" : /park|green|forest|grass|meadow|tree/.test(kind) ? "green" : "house";
      areas[sort].addPath(path(flat, true));
    }
    const all = (list) => list.reduce((p, flat) => (p.addPath(path(flat, true)), p), new Path2D());
    const stops = new Map();
    for (const [light, index, x, y, heading, width] of net.heads) {
      const key = x + ":" + y;
      if (!stops.has(key)) stops.set(key, { light, x, y, heading, width, indices: [] });
      stops.get(key).indices.push(index);
    }
    this.net = { lanes: [...lanes.values()].sort((a, b) => b.kind - a.kind), areas, junctions: all(net.junctions), crossings: all(net.crossings), stops: [...stops.values()], bounds: net.bounds };
    this.stillOf = null;
    const [x0, y0, x1, y1] = net.bounds;
    if (!this.state) this.centre = [(x0 + x1) / 2, (y0 + y1) / 2];
  }

  setRoute(line) {
    this.route = new Path2D();
    for (let i = 0; i + 1 < line.length; i += 2) i ? this.route.lineTo(line[i], line[i + 1]) : this.route.moveTo(line[i], line[i + 1]);
    this.goal = line.slice(-2);
  }

  update(state) {
    const last = this.trail[this.trail.length - 1];
    const { x, y } = state.ego;
    const jump = last ? Math.hypot(x - last[0], y - last[1]) : 99;
    if (jump > 25) this.trail = [];
    if (jump > 0.3) this.trail.push([x, y]);
    if (this.trail.length > 1500) this.trail.shift();
    if (!this.state && this.follow) this.centre = [x, y];
    this.state = state;
    this.lights = new Map(state.lights);
    this.got = performance.now();
  }

  // Simulated seconds since the tick that is shown: things go on moving until the next one comes.
  since() {
    const s = this.state;
    if (!s || s.paused || s.over || !(s.speed_factor > 0) || this.calm.matches) return 0;
    return Math.min(((performance.now() - this.got) / 1000) * s.speed_factor, s.dt * 1.2);
  }

  size() {
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    const [w, h] = [this.canvas.clientWidth, this.canvas.clientHeight];
    if (this.canvas.width !== Math.round(w * ratio) || this.canvas.height !== Math.round(h * ratio)) {
      this.canvas.width = Math.round(w * ratio);
      this.canvas.height = Math.round(h * ratio);
      this.stillOf = null;
    }
    return [w, h, ratio];
  }

  draw(force) {
    if (!this.net) return;
    const [w, h, ratio] = this.size();
    if (!w || !h) return;
    const c = this.context, s = this.state, t = this.since();
    let ego = null;
    if (s) {
      const e = s.ego, turn = e.yaw_rate * t;
      const heading = e.heading + turn;
      const way = e.speed * t;
      ego = { ...e, x: e.x + way * Math.cos(e.heading + turn / 2), y: e.y + way * Math.sin(e.heading + turn / 2), heading };
      if (this.follow) this.centre = [ego.x, ego.y];
    }
    const wanted = this.turn && ego ? Math.PI / 2 - ego.heading : 0;
    const off = Math.atan2(Math.sin(wanted - this.angle), Math.cos(wanted - this.angle));
    this.angle += this.turn ? off * (this.calm.matches || force ? 1 : 0.25) : off;
    const low = this.turn && this.follow ? 0.68 : 0.5;
    const z = this.zoom * ratio, cos = Math.cos(this.angle), sin = Math.sin(this.angle);
    const [cx, cy] = this.centre;
    const e = (w * ratio) / 2 - z * (cx * cos - cy * sin), f = h * ratio * low + z * (cx * sin + cy * cos);
    this.matrix = [z * cos, -z * sin, -z * sin, -z * cos, e, f];
    c.setTransform(1, 0, 0, 1, 0, 0);
    c.fillStyle = this.colour.grass;
    c.fillRect(0, 0, this.canvas.width, this.canvas.height);
    this.drawStill(w, h, ratio);
    c.setTransform(...this.matrix);
    c.lineCap = "round";
    c.lineJoin = "round";
    const thin = (px) => px / this.zoom;
    if (this.route) {
      c.strokeStyle = this.colour.route;
      c.globalAlpha = 0.45;
      c.lineWidth = Math.max(1.6, thin(4));
      c.stroke(this.route);
      c.globalAlpha = 1;
      if (this.goal) this.dot(this.goal[0], this.goal[1], Math.max(2.2, thin(6)), this.colour.route);
    }
    if (this.trail.length > 1) {
      c.strokeStyle = this.colour.ego;
      c.globalAlpha = 0.6;
      c.lineWidth = Math.max(0.5, thin(2));
      c.beginPath();
      this.trail.forEach(([x, y], i) => (i ? c.lineTo(x, y) : c.moveTo(x, y)));
      if (ego) c.lineTo(ego.x, ego.y);
      c.stroke();
      c.globalAlpha = 1;
    }
    if (s) {
      this.drawLights(thin);
      for (const actor of s.actors) this.drawActor(actor, t, thin);
      this.fellows(t).forEach((fellow) => this.drawEgo(fellow, thin, true));
      this.drawEgo(ego, thin);
    }
    this.drawScale();
  }

  // The net as a picture somewhat larger than the canvas, made anew where it no longer covers it.
  drawStill(w, h, ratio) {
    const reach = Math.hypot(w, h) * 0.75;
    const old = this.stillOf;
    const moved = old ? Math.hypot(this.centre[0] - old.x, this.centre[1] - old.y) * this.zoom : Infinity;
    if (!old || old.zoom !== this.zoom || moved > reach * 0.22) {
      const side = Math.ceil(2 * reach * ratio);
      if (this.still.width !== side) this.still.width = this.still.height = side;
      const z = this.zoom * ratio, [x, y] = this.centre;
      const c = this.still.getContext("2d");
      c.setTransform(1, 0, 0, 1, 0, 0);
      c.fillStyle = this.colour.grass;
      c.fillRect(0, 0, side, side);
      c.setTransform(z, 0, 0, -z, side / 2 - z * x, side / 2 + z * y);
      this.paintNet(c);
      this.stillOf = { x, y, zoom: this.zoom, side };
    }
    const c = this.context, { x, y, side } = this.stillOf, z = this.zoom * ratio;
    const [m, n, o, p, e, f] = this.matrix;
    c.setTransform(m / z, n / z, -o / z, -p / z, m * x + o * y + e, n * x + p * y + f);
    c.drawImage(this.still, -side / 2, -side / 2);
  }

  paintNet(c) {
    const { lanes, areas, junctions, crossings } = this.net, col = this.colour, z = this.zoom;
    c.fillStyle = col.water; c.fill(areas.water);
    c.fillStyle = col.grass; c.fill(areas.green);
    c.fillStyle = col.house; c.fill(areas.house);
    c.lineCap = "butt";
    c.lineJoin = "round";
    const stroke = (wanted, colour, more) => {
      c.strokeStyle = colour;
      for (const lane of lanes) if (wanted(lane.kind)) { c.lineWidth = Math.max(lane.width + more, 0.7 / z); c.stroke(lane.path); }
    };
    stroke((kind) => kind >= 2, col.walk, 0.4);
    c.fillStyle = col.junction; c.fill(junctions);
    stroke((kind) => kind === 0, col.mark, 0.15);
    stroke((kind) => kind <= 1, col.road, -0.12);
    c.fillStyle = col.junction; c.fill(junctions);
    if (z > 1.5) { c.fillStyle = col.mark; c.globalAlpha = 0.65; c.fill(crossings); c.globalAlpha = 1; }
  }

  drawLights(thin) {
    const c = this.context;
    c.lineCap = "butt";
    for (const stop of this.net.stops) {
      const states = this.lights.get(stop.light);
      if (!states) continue;
      const n = stop.indices.length, width = Math.max(stop.width * 0.9, thin(4)), part = width / n;
      const nx = -Math.sin(stop.heading), ny = Math.cos(stop.heading);
      stop.indices.forEach((index, i) => {
        // The rightmost link first.
        const from = -width / 2 + part * i;
        c.strokeStyle = LIGHTS[states[index]] || "#8894a3";
        c.lineWidth = Math.max(0.8, thin(3.5));
        c.beginPath();
        c.moveTo(stop.x + nx * from, stop.y + ny * from);
        c.lineTo(stop.x + nx * (from + part * 0.92), stop.y + ny * (from + part * 0.92));
        c.stroke();
      });
    }
  }

  drawActor([, kind, x, y, heading, length, width, speed, lights], t, thin) {
    const c = this.context, col = this.colour;
    const px = x + Math.cos(heading) * speed * t, py = y + Math.sin(heading) * speed * t;
    if (kind === 6) return this.dot(px, py, Math.max(0.45, thin(2.6)), col.person);
    c.save();
    c.translate(px, py);
    c.rotate(heading);
    const grow = Math.max(1, thin(5) / width);
    const [l, w] = [length * Math.min(grow, 1.6), width * grow];
    c.fillStyle = kind === 7 ? col.bad : kind >= 4 ? col.two : col.car;
    c.beginPath();
    c.roundRect(-l / 2, -w / 2, l, w, w * 0.25);
    c.fill();
    if (kind < 4 && this.zoom > 3) {
      c.fillStyle = col.card;
      c.globalAlpha = 0.55;
      c.fillRect(l * 0.12, -w * 0.4, l * 0.13, w * 0.8);
      c.globalAlpha = 1;
    }
    if (lights & 1) { c.fillStyle = "#ff2d20"; c.fillRect(-l / 2, -w / 2, l * 0.09, w); }
    c.fillStyle = "#ffb000";
    if (lights & 2) c.fillRect(l * 0.3, w * 0.3, l * 0.2, w * 0.2);
    if (lights & 4) c.fillRect(l * 0.3, -w / 2, l * 0.2, w * 0.2);
    c.restore();
  }

  // The egos that are not followed.
  fellows(t) {
    const s = this.state;
    return (s.egos || []).map(([x, y, heading, speed, length, width], index) => ({ x: x + speed * t * Math.cos(heading), y: y + speed * t * Math.sin(heading), heading, length, width, index })).filter((e) => e.index !== s.followed);
  }

  drawEgo(ego, thin, fellow) {
    const c = this.context, grow = Math.max(1, thin(9) / ego.width);
    const [l, w] = [ego.length * Math.min(grow, 2.2), ego.width * grow];
    c.save();
    c.translate(ego.x, ego.y);
    c.rotate(ego.heading);
    c.fillStyle = fellow ? this.colour.card : this.colour.ego;
    c.strokeStyle = fellow ? this.colour.ego : this.colour.card;
    c.lineWidth = thin(1.6);
    c.beginPath();
    c.moveTo(l / 2, 0);
    c.lineTo(l * 0.22, w / 2); c.lineTo(-l / 2, w / 2); c.lineTo(-l / 2, -w / 2); c.lineTo(l * 0.22, -w / 2);
    c.closePath();
    c.fill();
    c.stroke();
    if (!fellow && this.state.control.brake > 0.05) { c.fillStyle = "#fff"; c.fillRect(-l / 2, -w / 2, l * 0.1, w); }
    c.restore();
  }

  dot(x, y, r, colour) {
    const c = this.context;
    c.fillStyle = colour;
    c.beginPath();
    c.arc(x, y, r, 0, 7);
    c.fill();
  }

  drawScale() {
    const good = [5, 10, 20, 50, 100, 200, 500, 1000, 2000].find((m) => m * this.zoom > 55) || 5000;
    const key = good + ":" + this.zoom;
    if (this.scaleKey === key) return;
    this.scaleKey = key;
    this.scaleBar.querySelector("i").style.width = good * this.zoom + "px";
    this.scaleBar.querySelector("span").textContent = good + " m";
  }

  // ---- moving about ----

  showAll() {
    const [x0, y0, x1, y1] = this.net.bounds;
    const [w, h] = [this.canvas.clientWidth || 300, this.canvas.clientHeight || 300];
    this.centre = [(x0 + x1) / 2, (y0 + y1) / 2];
    this.zoom = Math.max(0.02, 0.95 * Math.min(w / Math.max(x1 - x0, 1), h / Math.max(y1 - y0, 1)));
    this.setFollow(false);
    this.setTurn(false);
  }

  setFollow(on) {
    if (on && this.zoom < 1.5) this.zoom = 4;
    this.follow = on;
    this.onView(this);
  }

  setTurn(on) {
    this.turn = on;
    if (on) this.setFollow(true);
    this.onView(this);
  }

  zoomBy(factor, at) {
    const next = Math.min(40, Math.max(0.05, this.zoom * factor));
    if (at && !this.follow) {
      const k = 1 / this.zoom - 1 / next;
      this.centre[0] += at[0] * k;
      this.centre[1] -= at[1] * k;
    }
    this.zoom = next;
  }

  pan(dx, dy) {
    if (this.follow) this.setFollow(false);
    const cos = Math.cos(this.angle), sin = Math.sin(this.angle);
    this.centre[0] -= (dx * cos + -dy * sin) / this.zoom;
    this.centre[1] -= (-dx * sin - dy * cos) / this.zoom;
  }

  listen() {
    const canvas = this.canvas, fingers = new Map();
    canvas.addEventListener("click", (e) => {
      if (!this.state?.egos || !this.matrix) return;
      const box = canvas.getBoundingClientRect(), ratio = canvas.width / box.width, [m, n, o, p, x0, y0] = this.matrix;
      const far = (f) => Math.hypot(m * f.x + o * f.y + x0 - (e.clientX - box.left) * ratio, n * f.x + p * f.y + y0 - (e.clientY - box.top) * ratio) / ratio;
      const nearest = this.fellows(0).map((f) => [far(f), f.index]).sort((a, b) => a[0] - b[0])[0];
      if (nearest && nearest[0] < 24) this.onPick(nearest[1]);
    });
    canvas.addEventListener("pointerdown", (e) => { canvas.setPointerCapture(e.pointerId); fingers.set(e.pointerId, [e.clientX, e.clientY]); });
    const up = (e) => fingers.delete(e.pointerId);
    canvas.addEventListener("pointerup", up);
    canvas.addEventListener("pointercancel", up);
    canvas.addEventListener("pointermove", (e) => {
      const last = fingers.get(e.pointerId);
      if (!last) return;
      const apart = () => { const [a, b] = [...fingers.values()]; return Math.hypot(a[0] - b[0], a[1] - b[1]); };
      const before = fingers.size === 2 ? apart() : 0;
      fingers.set(e.pointerId, [e.clientX, e.clientY]);
      if (fingers.size === 2 && before > 0) this.zoomBy(apart() / before);
      else if (fingers.size === 1) this.pan(e.clientX - last[0], e.clientY - last[1]);
    });
    canvas.addEventListener("wheel", (e) => {
      e.preventDefault();
      const box = canvas.getBoundingClientRect();
      this.zoomBy(Math.exp(-e.deltaY * 0.0015), [e.clientX - box.left - box.width / 2, e.clientY - box.top - box.height / 2]);
    }, { passive: false });
    canvas.addEventListener("keydown", (e) => {
      const step = { ArrowLeft: [60, 0], ArrowRight: [-60, 0], ArrowUp: [0, 60], ArrowDown: [0, -60] }[e.key];
      if (step && !document.body.classList.contains("driving")) { e.preventDefault(); e.stopPropagation(); this.pan(...step); }
    });
  }
}
