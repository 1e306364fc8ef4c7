// Keys, gamepad and touch become wheel, pedals and gear; the server smooths them.

const KEYS = { ArrowUp: "throttle", KeyW: "throttle", ArrowDown: "brake", KeyS: "brake", Space: "brake", ArrowLeft: "left", KeyA: "left", ArrowRight: "right", KeyD: "right" };

export class Hands {
  constructor(send, pads) {
    this.send = send;
    this.held = new Set();
    this.driving = false;
    this.reverse = false;
    this.gear = pads.querySelector("[data-gear]");
    this.gear.addEventListener("click", () => this.shift());
    this.last = "";
    addEventListener("keydown", (e) => this.key(e, true));
    addEventListener("keyup", (e) => this.key(e, false));
    addEventListener("blur", () => { this.held.clear(); this.tell(); });
    for (const button of pads.querySelectorAll("[data-key]")) {
      const name = button.dataset.key;
      const hold = (on) => (e) => {
        e.preventDefault();
        on ? this.held.add("pad " + name) : this.held.delete("pad " + name);
        button.classList.toggle("held", on);
        if (on && e.pointerId !== undefined) button.setPointerCapture(e.pointerId);
        this.tell();
      };
      button.addEventListener("pointerdown", hold(true));
      for (const end of ["pointerup", "pointercancel", "lostpointercapture"]) button.addEventListener(end, hold(false));
      button.addEventListener("contextmenu", (e) => e.preventDefault());
    }
  }

  start() {
    if (this.driving) return;
    this.driving = true;
    this.held.clear();
    this.shift(false);
    // The heartbeat too: who says nothing for 0.8 s has gone.
    this.timer = setInterval(() => this.tell(true), 60);
    this.beat = 0;
    this.tell(true);
  }

  stop() {
    this.driving = false;
    clearInterval(this.timer);
    this.held.clear();
  }

  // Into reverse gear or out of it.
  shift(reverse = !this.reverse) {
    this.reverse = reverse;
    this.gear.setAttribute("aria-pressed", reverse);
    this.tell();
  }

  key(event, down) {
    const name = event.code === "KeyQ" ? "gear" : KEYS[event.code];
    if (!this.driving || !name || event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.target.closest?.("input, select, textarea, dialog")) return;
    event.preventDefault();
    event.stopImmediatePropagation();
    if (name === "gear") {
      if (down && !event.repeat) this.shift();
      return;
    }
    down ? this.held.add(event.code) : this.held.delete(event.code);
    this.tell();
  }

  wanted() {
    const on = (name) => this.held.has("pad " + name) || [...this.held].some((code) => KEYS[code] === name);
    const keys = { steer: (on("left") ? 1 : 0) - (on("right") ? 1 : 0), throttle: on("throttle") ? 1 : 0, brake: on("brake") ? 1 : 0 };
    if (this.held.size) return keys;
    for (const pad of navigator.getGamepads?.() || []) {
      if (!pad) continue;
      const shifts = pad.buttons[3]?.pressed || false;
      if (shifts && !this.shifting) this.reverse = !this.reverse;
      this.shifting = shifts;
      const axis = pad.axes[0] || 0, gas = pad.buttons[7]?.value || 0, stop = pad.buttons[6]?.value || 0;
      const steer = Math.abs(axis) < 0.08 ? 0 : -axis * Math.abs(axis);
      if (steer || gas > 0.02 || stop > 0.02) return { steer, throttle: gas, brake: stop, analog: true };
    }
    return keys;
  }

  tell(timed) {
    if (!this.driving) return;
    const wanted = this.wanted();
    const round = (v) => Math.round(Math.max(-1, Math.min(1, v)) * 1000) / 1000;
    const text = JSON.stringify({ do: "drive", ...wanted, reverse: this.reverse, steer: round(wanted.steer), throttle: round(wanted.throttle), brake: round(wanted.brake) });
    const now = performance.now();
    if (text === this.last && timed && now - this.beat < 200) return;
    this.last = text;
    this.beat = now;
    this.send(text);
  }
}
