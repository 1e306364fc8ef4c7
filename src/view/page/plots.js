// The dial, and the reward's course: one row a term over the last minute, the running sum above.

export const TERMS = ["timeout", "collision", "lane", "speed", "light", "steps"];
const WINDOW = 60;

const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

function sized(canvas) {
  const ratio = Math.min(window.devicePixelRatio || 1, 2);
  const [w, h] = [canvas.clientWidth, canvas.clientHeight];
  if (canvas.width !== Math.round(w * ratio) || canvas.height !== Math.round(h * ratio)) {
    canvas.width = Math.round(w * ratio);
    canvas.height = Math.round(h * ratio);
  }
  const c = canvas.getContext("2d");
  c.setTransform(ratio, 0, 0, ratio, 0, 0);
  c.clearRect(0, 0, w, h);
  return [c, w, h];
}

export function dial(canvas, speed, limit) {
  const [c, w, h] = sized(canvas);
  if (!w) return;
  const kmh = Math.max(0, speed * 3.6), most = Math.max(60, Math.ceil((limit * 3.6 * 1.4) / 20) * 20);
  const x = w / 2, y = h - 22, r = Math.min(w / 2 - 6, h - 30);
  const angle = (v) => Math.PI * (1 + Math.min(v / most, 1));
  c.lineCap = "butt";
  c.lineWidth = 10;
  c.strokeStyle = css("--line");
  c.beginPath(); c.arc(x, y, r, Math.PI, 2 * Math.PI); c.stroke();
  const over = kmh > limit * 3.6 + 1;
  c.strokeStyle = css(over ? "--bad" : "--accent");
  c.beginPath(); c.arc(x, y, r, Math.PI, angle(kmh)); c.stroke();
  if (limit > 0) {
    const a = angle(limit * 3.6);
    c.strokeStyle = css("--bad");
    c.lineWidth = 3;
    c.beginPath();
    c.moveTo(x + (r - 8) * Math.cos(a), y + (r - 8) * Math.sin(a));
    c.lineTo(x + (r + 6) * Math.cos(a), y + (r + 6) * Math.sin(a));
    c.stroke();
  }
  c.textAlign = "center";
  c.fillStyle = css(over ? "--bad" : "--ink");
  c.font = "650 30px system-ui, DejaVu Sans, sans-serif";
  c.fillText(kmh.toFixed(0), x, y - 4);
  c.fillStyle = css("--soft");
  c.font = "12px system-ui, DejaVu Sans, sans-serif";
  c.fillText(limit > 0 ? `km/h · limit ${(limit * 3.6).toFixed(0)}` : "km/h", x, y + 15);
}

// `points`: [time, speed, limit, six terms].
export function reward(canvas, points, sums) {
  const [c, w, h] = sized(canvas);
  if (!w) return;
  const colours = css("--terms").split(",").map((s) => s.trim());
  const [ink, soft, line] = [css("--ink"), css("--soft"), css("--line")];
  const last = points.length ? points[points.length - 1][0] : 0;
  const seen = points.filter((p) => p[0] > last - WINDOW);
  const font = (size, weight = 400) => (c.font = `${weight} ${size}px system-ui, DejaVu Sans, sans-serif`);
  const told = (total) => (Math.abs(total) >= 1000 ? total.toFixed(0) : total.toFixed(1));
  // Columns as wide as their widest number.
  const sum0 = sums.reduce((a, b) => a + b, 0), now0 = seen.length ? seen[seen.length - 1].slice(3) : [];
  font(12, 650);
  const widest = (texts) => Math.max(28, ...texts.map((text) => c.measureText(text).width));
  const sumsWidth = widest([sum0, ...sums].map(told));
  const nowWidth = widest([now0.reduce((a, b) => a + b, 0), ...now0].map((v) => v.toFixed(2)));
  const nowAt = w - 2 - sumsWidth - 12;
  const left = 66, right = w - nowAt + nowWidth + 12, width = Math.max(w - left - right, 20);
  const at = (time) => left + width * (1 - (last - time) / WINDOW);
  const sumTop = 14, sumHeight = 44;
  font(10.5);
  c.fillStyle = soft;
  c.textAlign = "right"; c.fillText("now", nowAt, 9); c.fillText("sum", w - 2, 9);
  c.textAlign = "left"; c.fillText("last minute", left, 9);
  // All terms together, summed over what is seen.
  let sum = 0;
  const course = seen.map((p) => [p[0], (sum += p.slice(3).reduce((a, b) => a + b, 0))]);
  row("all", "", sumTop, sumHeight, course, sum0, now0.reduce((a, b) => a + b, 0), ink, 650);
  const top = sumTop + sumHeight + 6, step = (h - top) / TERMS.length;
  TERMS.forEach((name, i) => row(name, "", top + i * step, step - 3, seen.map((p) => [p[0], p[3 + i]]), sums[i], seen.length ? seen[seen.length - 1][3 + i] : 0, colours[i], 400));

  function row(name, _, y, height, course, total, now, colour, weight) {
    font(12, weight);
    c.textAlign = "left";
    c.fillStyle = ink;
    c.fillText(name, 0, y + height / 2 + 4);
    c.textAlign = "right";
    c.fillStyle = now < -1e-4 ? css("--bad") : ink;
    c.fillText(now.toFixed(2), nowAt, y + height / 2 + 4);
    c.fillStyle = ink;
    c.fillText(told(total), w - 2, y + height / 2 + 4);
    const low = Math.min(0, ...course.map((p) => p[1])), high = Math.max(0.05, ...course.map((p) => p[1]));
    const up = (v) => y + height - 1 - ((v - low) / (high - low)) * (height - 2);
    c.strokeStyle = line;
    c.lineWidth = 1;
    c.beginPath(); c.moveTo(left, up(0)); c.lineTo(left + width, up(0)); c.stroke();
    if (!course.length) return;
    c.strokeStyle = colour;
    c.lineWidth = 1.6;
    c.lineJoin = "round";
    c.beginPath();
    course.forEach(([time, v], k) => (k ? c.lineTo(at(time), up(v)) : c.moveTo(at(time), up(v))));
    c.stroke();
  }
}
