"use strict";
(() => {
  const told = document.getElementById("told");
  const tell = (words) => { told.textContent = words; };

  // ---- text to the clipboard, also where a page from a file may not use the newer interface
  async function copy(text, what) {
    let done = false;
    try {
      await navigator.clipboard.writeText(text);
      done = true;
    } catch {
      const field = document.createElement("textarea");
      field.value = text;
      field.className = "offscreen";
      document.body.append(field);
      field.select();
      done = document.execCommand("copy");
      field.remove();
    }
    tell(done ? what + " copied" : "the browser refused to copy");
    return done;
  }

  function button(words, title, action) {
    const made = document.createElement("button");
    made.type = "button";
    made.textContent = words;
    made.title = title;
    made.addEventListener("click", action);
    return made;
  }

  const lines = (table) =>
    [...table.rows].map((row) => [...row.cells].map((cell) => cell.textContent.trim()).join("\t"));

  for (const block of document.querySelectorAll("[data-copy]")) {
    const source = block.querySelector("table, pre");
    const made = button("copy", "copy, to paste into a spreadsheet or an editor", () => {
      const text = source.matches("table") ? lines(source).join("\n") : source.textContent;
      copy(text, block.dataset.copy);
    });
    made.className = "copy";
    block.prepend(made);
  }

  // ---- the estimate as the file that Estimate.load reads
  const kept = document.getElementById("estimate");
  const place = document.getElementById("keep");
  if (kept && place) {
    place.append(button("save model.json", "the estimate, for Estimate.load", () => {
      const link = document.createElement("a");
      link.href = URL.createObjectURL(new Blob([kept.textContent], { type: "application/json" }));
      link.download = "model.json";
      link.click();
      setTimeout(() => URL.revokeObjectURL(link.href), 1000);
      tell("model.json saved");
    }));
  }

  // ---- figures: one at a time in a window of its own, with wheel, pinch, drag and keys
  const dialog = document.getElementById("viewer");
  const stage = dialog.querySelector(".stage");
  const heading = dialog.querySelector("h2");
  let shown = null;

  const box = (svg) => svg.getAttribute("viewBox").split(/[ ,]+/).map(Number);
  const put = (frame) => shown.svg.setAttribute("viewBox", frame.map((v) => +v.toFixed(3)).join(" "));

  function at(x, y) {
    const point = new DOMPoint(x, y).matrixTransform(shown.svg.getScreenCTM().inverse());
    return [point.x, point.y];
  }

  function zoom(factor, x, y) {
    const [left, top, width, height] = box(shown.svg);
    const whole = shown.whole;
    const wide = Math.min(Math.max(width * factor, whole[2] / 60), whole[2]);
    const scale = wide / width;
    const [px, py] = x === undefined ? [left + width / 2, top + height / 2] : at(x, y);
    const inside = (value, low, size, span) => Math.min(Math.max(value, low), low + span - size);
    put([
      inside(px - (px - left) * scale, whole[0], wide, whole[2]),
      inside(py - (py - top) * scale, whole[1], height * scale, whole[3]),
      wide, height * scale,
    ]);
  }

  function move(dx, dy) {
    const [left, top, width, height] = box(shown.svg);
    const whole = shown.whole;
    const keep = (value, low, room) => Math.min(Math.max(value, low), low + Math.max(room, 0));
    put([
      keep(left + dx, whole[0], whole[2] - width), keep(top + dy, whole[1], whole[3] - height),
      width, height,
    ]);
  }

  const reset = () => shown.svg.setAttribute("viewBox", shown.given);

  function open(figure) {
    const svg = figure.querySelector("svg");
    const gap = document.createComment("figure");
    shown = { svg, gap, whole: box(svg), given: svg.getAttribute("viewBox"), from: figure.querySelector(".enlarge") };
    svg.replaceWith(gap);
    stage.append(svg);
    heading.textContent = figure.querySelector("h3").textContent;
    dialog.showModal();
  }

  function put_back() {
    if (!shown) return;
    reset();
    shown.gap.replaceWith(shown.svg);
    shown.from.focus();
    shown = null;
  }

  for (const figure of document.querySelectorAll("figure")) {
    const made = button("enlarge", "enlarge the figure; wheel or pinch to zoom", () => open(figure));
    made.className = "enlarge";
    figure.querySelector("h3").after(made);
    figure.querySelector("svg").addEventListener("dblclick", () => { if (!shown) open(figure); });
  }

  const tools = dialog.querySelector(".tools");
  tools.append(
    button("+", "closer", () => zoom(0.7)),
    button("\u2212", "farther", () => zoom(1 / 0.7)),
    button("whole", "the whole figure", reset),
    button("close", "close (Escape)", () => dialog.close()),
  );
  dialog.addEventListener("close", put_back);
  dialog.addEventListener("keydown", (event) => {
    const [, , width, height] = box(shown.svg);
    const keys = {
      "+": () => zoom(0.7), "=": () => zoom(0.7), "-": () => zoom(1 / 0.7), "0": reset,
      ArrowLeft: () => move(-width / 10, 0), ArrowRight: () => move(width / 10, 0),
      ArrowUp: () => move(0, -height / 10), ArrowDown: () => move(0, height / 10),
    };
    if (keys[event.key]) {
      keys[event.key]();
      event.preventDefault();
    }
  });
  stage.addEventListener("wheel", (event) => {
    zoom(Math.exp(Math.sign(event.deltaY) * 0.2), event.clientX, event.clientY);
    event.preventDefault();
  }, { passive: false });
  stage.addEventListener("dblclick", reset);

  const fingers = new Map();
  stage.addEventListener("pointerdown", (event) => {
    stage.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
  });
  stage.addEventListener("pointermove", (event) => {
    const before = fingers.get(event.pointerId);
    if (!before || !shown) return;
    const now = [event.clientX, event.clientY];
    if (fingers.size === 1) {
      const [x0, y0] = at(...before);
      const [x1, y1] = at(...now);
      move(x0 - x1, y0 - y1);
    } else {
      const [other] = [...fingers].filter(([id]) => id !== event.pointerId).map(([, where]) => where);
      const far = (where) => Math.hypot(where[0] - other[0], where[1] - other[1]) || 1;
      zoom(far(before) / far(now), (now[0] + other[0]) / 2, (now[1] + other[1]) / 2);
    }
    fingers.set(event.pointerId, now);
  });
  const lift = (event) => fingers.delete(event.pointerId);
  stage.addEventListener("pointerup", lift);
  stage.addEventListener("pointercancel", lift);
})();
