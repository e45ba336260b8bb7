"use strict";
// The flip-books: two images with a wipe between them, zoom, pan and exposure. Tone mapping is that of eval/display.py.
const SHOULDER = 0.8;

function decode(uri, width, height) {
  return new Promise((resolve, reject) => {
    const image = new Image();
    image.onload = () => {
      const canvas = document.createElement("canvas");
      canvas.width = width;
      canvas.height = height;
      const context = canvas.getContext("2d");
      context.drawImage(image, 0, 0);
      resolve(context.getImageData(0, 0, width, height).data);
    };
    image.onerror = reject;
    image.src = uri;
  });
}

const srgb = (x) => 255 * (x <= 0.0031308 ? 12.92 * x : 1.055 * x ** (1 / 2.4) - 0.055);

function toneMapped(codes, linear, exposure) {
  const out = new Uint8ClampedArray(codes.length), d = 1 - SHOULDER;
  for (let i = 0; i < codes.length; i += 4) {
    const rgb = [0, 1, 2].map((c) => linear[codes[i + c]] * exposure);
    const peak = Math.max(...rgb);
    let scale = 1, white = 0, bent = 0;
    if (peak > SHOULDER) {
      bent = 1 - d * d / (peak + d - SHOULDER);
      scale = bent / peak;
      white = 1 - 1 / (0.15 * (peak - bent) + 1);
    }
    for (let c = 0; c < 3; c++) {
      const x = rgb[c] * scale;
      out[i + c] = srgb(x + (bent - x) * white);
    }
    out[i + 3] = 255;
  }
  return out;
}

function coloured(codes, colours) {
  const out = new Uint8ClampedArray(codes.length);
  for (let i = 0; i < codes.length; i += 4) out.set([...colours[codes[i]], 255], i);
  return out;
}

async function open(root) {
  const find = (name) => root.querySelector(name);
  const book = JSON.parse(find("script").textContent);
  const { width, height } = book;
  const linear = Float64Array.from({ length: 256 }, (_, v) => book.dark * Math.expm1(v / 255 * Math.log1p(book.peak / book.dark)));
  const codes = await Promise.all(book.images.map((image) => decode(image.uri, width, height)));
  const canvas = find("canvas"), context = canvas.getContext("2d");
  const left = find(".left"), right = find(".right"), wipe = find(".wipe"), exposure = find(".exposure");
  const view = { zoom: 1, x: 0, y: 0 };
  const shown = new Map();
  // Enough canvas pixels for a zoomed image to have sharp edges.
  const factor = Math.max(1, Math.ceil(960 / width));
  canvas.width = width * factor;
  canvas.height = height * factor;

  function layer(index) {
    const radiance = book.images[index].kind === "radiance";
    const key = radiance ? `${index} ${exposure.value}` : `${index}`;
    if (!shown.has(key)) {
      const data = radiance ? toneMapped(codes[index], linear, 2 ** exposure.value) : coloured(codes[index], book.colours);
      const sheet = document.createElement("canvas");
      sheet.width = width;
      sheet.height = height;
      sheet.getContext("2d").putImageData(new ImageData(data, width, height), 0, 0);
      if (shown.size > 8) shown.clear();
      shown.set(key, sheet);
    }
    return shown.get(key);
  }

  function draw() {
    view.zoom = Math.min(32, Math.max(1, view.zoom));
    view.x = Math.min(width - width / view.zoom, Math.max(0, view.x));
    view.y = Math.min(height - height / view.zoom, Math.max(0, view.y));
    const border = Math.round(canvas.width * wipe.value / 100);
    context.imageSmoothingEnabled = false;
    for (const [select, from, to] of [[left, 0, border], [right, border, canvas.width]]) {
      context.save();
      context.beginPath();
      context.rect(from, 0, to - from, canvas.height);
      context.clip();
      context.drawImage(layer(Number(select.value)), view.x, view.y, width / view.zoom, height / view.zoom, 0, 0, canvas.width, canvas.height);
      context.restore();
    }
    if (border > 0 && border < canvas.width) {
      context.fillStyle = "#fff";
      context.fillRect(border - 1, 0, 2, canvas.height);
      context.fillStyle = "#000";
      context.fillRect(border + 1, 0, 1, canvas.height);
    }
    find("output").textContent = `${exposure.value} EV`;
    canvas.dataset.zoom = view.zoom;
    const names = [left, right].map((select) => select.selectedOptions[0].textContent);
    canvas.setAttribute("aria-label", `${root.dataset.name}: ${names[0]} left, ${names[1]} right`);
  }

  function zoom(by, x = view.x + width / view.zoom / 2, y = view.y + height / view.zoom / 2) {
    const before = view.zoom;
    view.zoom = Math.min(32, Math.max(1, before * by));
    view.x = x - (x - view.x) * before / view.zoom;
    view.y = y - (y - view.y) * before / view.zoom;
    draw();
  }

  function place(event) {
    const box = canvas.getBoundingClientRect();
    return [
      view.x + (event.clientX - box.left) / box.width * width / view.zoom,
      view.y + (event.clientY - box.top) / box.height * height / view.zoom,
    ];
  }

  function read(event) {
    const [x, y] = place(event).map(Math.floor);
    if (x < 0 || y < 0 || x >= width || y >= height) return;
    const values = [left, right].map((select) => {
      const index = Number(select.value), image = book.images[index];
      const at = 4 * (y * width + x);
      if (image.kind !== "radiance") return `${image.name}: ${(book.reach * (codes[index][at] / 255) ** 2).toPrecision(2)}`;
      return `${image.name}: ${[0, 1, 2].map((c) => linear[codes[index][at + c]].toPrecision(2)).join(", ")}`;
    });
    find(".readout").textContent = `Pixel (${x}, ${y}), linear RGB or tvi error. ${values.join("; ")}.`;
  }

  for (const control of [left, right, wipe, exposure]) control.addEventListener("input", draw);
  find(".in").addEventListener("click", () => zoom(2));
  find(".out").addEventListener("click", () => zoom(0.5));
  find(".reset").addEventListener("click", () => zoom(1 / view.zoom));
  canvas.addEventListener("wheel", (event) => {
    if (!event.ctrlKey) return; // the wheel alone scrolls the page
    event.preventDefault();
    zoom(event.deltaY < 0 ? 1.25 : 0.8, ...place(event));
  }, { passive: false });
  let last = null;
  canvas.addEventListener("pointerdown", (event) => {
    last = event;
    canvas.setPointerCapture(event.pointerId);
    read(event);
  });
  canvas.addEventListener("pointermove", (event) => {
    if (last) {
      const box = canvas.getBoundingClientRect();
      view.x -= (event.clientX - last.clientX) / box.width * width / view.zoom;
      view.y -= (event.clientY - last.clientY) / box.height * height / view.zoom;
      last = event;
      draw();
    }
    read(event);
  });
  for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, () => { last = null; });
  canvas.addEventListener("keydown", (event) => {
    const step = 0.1 / view.zoom;
    const moves = { ArrowLeft: [-step, 0], ArrowRight: [step, 0], ArrowUp: [0, -step], ArrowDown: [0, step] };
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.key in moves) {
      view.x += moves[event.key][0] * width;
      view.y += moves[event.key][1] * height;
      draw();
    } else if (event.key === "+" || event.key === "=") zoom(2);
    else if (event.key === "-") zoom(0.5);
    else if (event.key === "0") zoom(1 / view.zoom);
    else if (event.key === " ") {
      [left.value, right.value] = [right.value, left.value];
      draw();
    } else return;
    event.preventDefault();
  });
  draw();
  root.dataset.ready = "true";
}

const scrolls = new ResizeObserver((entries) => {
  for (const { target } of entries) target.classList.toggle("more", target.scrollWidth > target.clientWidth);
});
for (const table of document.querySelectorAll(".scroll")) scrolls.observe(table);
for (const root of document.querySelectorAll(".book")) open(root);
