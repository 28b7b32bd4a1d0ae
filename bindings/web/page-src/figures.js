// The three figures: what stays, what leaves, what an attacker recovers.

/** Resizes a canvas to its displayed size; returns its context, scaled to image pixels. */
function begin(canvas, width, height) {
  const shown = Math.min(1200, Math.max(320, canvas.clientWidth * (devicePixelRatio || 1)));
  const scale = shown / width;
  canvas.width = Math.round(width * scale);
  canvas.height = Math.round(height * scale);
  const context = canvas.getContext("2d");
  context.setTransform(scale, 0, 0, scale, 0, 0);
  return { context, pixel: 1 / scale };
}

const dots = (context, points, radius) => {
  context.beginPath();
  for (let i = 0; i < points.length; i += 2) {
    context.moveTo(points[i] + radius, points[i + 1]);
    context.arc(points[i], points[i + 1], radius, 0, 7);
  }
};

/** Draws the image and its keypoints. */
export function drawStays(canvas, image, width, height, keypoints = []) {
  const { context, pixel } = begin(canvas, width, height);
  context.drawImage(image, 0, 0, width, height);
  dots(context, keypoints, 1.9 * pixel * (devicePixelRatio || 1));
  context.fillStyle = "#ffc857";
  context.strokeStyle = "rgba(0,0,0,.55)";
  context.lineWidth = 0.6 * pixel;
  context.fill();
  context.stroke();
}

/** Draws the lines and their anchors. */
export function drawLeaves(canvas, { width, height, segments, anchors }) {
  const { context, pixel } = begin(canvas, width, height);
  context.fillStyle = "#0d1014";
  context.fillRect(0, 0, width, height);
  context.lineWidth = Math.max(0.5, 0.7 * pixel);
  context.strokeStyle = `rgba(140, 205, 245, ${Math.min(0.6, 220 / (segments.length / 4 + 1)).toFixed(3)})`;
  context.beginPath();
  for (let i = 0; i < segments.length; i += 4) {
    context.moveTo(segments[i], segments[i + 1]);
    context.lineTo(segments[i + 2], segments[i + 3]);
  }
  context.stroke();
  dots(context, anchors.flat(), 5 * pixel);
  context.fillStyle = "#ffc857";
  context.fill();
}

/** Draws the keypoints that an attack recovers, and the true ones. */
export function drawAttackResult(canvas, { width, height, answers, truth }) {
  const { context, pixel } = begin(canvas, width, height);
  const unit = pixel * (devicePixelRatio || 1);
  context.fillStyle = "#0d1014";
  context.fillRect(0, 0, width, height);
  context.strokeStyle = "rgba(255, 122, 110, .16)";
  context.lineWidth = 0.7 * unit;
  context.beginPath();
  for (let i = 0; i < truth.length; i += 2) {
    if (!Number.isFinite(answers[i])) continue;
    context.moveTo(truth[i], truth[i + 1]);
    context.lineTo(answers[i], answers[i + 1]);
  }
  context.stroke();
  dots(context, answers, 1.4 * unit);
  context.fillStyle = "#ff7a6e";
  context.fill();
  dots(context, truth, 1.2 * unit);
  context.fillStyle = "#ffc857";
  context.fill();
}

/** Clears a canvas. */
export function clear(canvas) {
  const context = canvas.getContext("2d");
  context.setTransform(1, 0, 0, 1, 0, 0);
  context.clearRect(0, 0, canvas.width, canvas.height);
}
