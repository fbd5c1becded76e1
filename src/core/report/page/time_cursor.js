(() => {
  // One cursor and one range of time for all figures over time. Drag: zoom; double click: all again.
  const NS = 'http://www.w3.org/2000/svg';
  const panels = [...document.querySelectorAll('g.panel')].map((g) => {
    const list = (name) => (g.dataset[name] || '').split(' ').map(Number);
    return { g, at: list('at'), t: list('t'), v: list('v'), data: g.querySelector('.data'), clip: g.querySelector('.clip') };
  });
  if (!panels.length) return;
  const box = document.body.appendChild(Object.assign(document.createElement('div'), { className: 'cursor', hidden: true }));
  let range = null;
  const shown = (p) => (p.data && range ? range : p.t);
  const x = (p, t) => p.at[0] + ((t - shown(p)[0]) / (shown(p)[1] - shown(p)[0])) * (p.at[2] - p.at[0]);
  const add = (p, name, attributes) => {
    const e = p.g.appendChild(document.createElementNS(NS, name));
    for (const [key, value] of Object.entries(attributes)) e.setAttribute(key, value);
    return e;
  };
  // The panel under the pointer, and the time there.
  const under = (event) => {
    for (const p of panels) {
      const matrix = p.g.getScreenCTM();
      if (!matrix || !p.g.ownerSVGElement.getBoundingClientRect().width) continue;
      const at = new DOMPoint(event.clientX, event.clientY).matrixTransform(matrix.inverse());
      if (at.x < p.at[0] || at.x > p.at[2] || at.y < p.at[1] || at.y > p.at[3]) continue;
      const [from, to] = shown(p);
      return { p, t: from + ((at.x - p.at[0]) / (p.at[2] - p.at[0])) * (to - from) };
    }
    return null;
  };
  // What the curves of a panel are at a time: between the points that are drawn.
  const values = (p, t) => {
    if (!p.data || p.v.length < 3) return [];
    const at = p.at[0] + ((t - p.t[0]) / (p.t[1] - p.t[0])) * (p.at[2] - p.at[0]);
    const found = [];
    for (const path of p.data.querySelectorAll('path.line')) {
      path.points ??= (path.getAttribute('d').match(/-?[\d.]+/g) || []).map(Number);
      const c = path.points;
      for (let i = 0; i + 3 < c.length; i += 2) {
        if (c[i] > at || c[i + 2] < at) continue;
        const share = c[i + 2] > c[i] ? (at - c[i]) / (c[i + 2] - c[i]) : 0;
        const up = 1 - (c[i + 1] + share * (c[i + 3] - c[i + 1]) - p.at[1]) / (p.at[3] - p.at[1]);
        const [low, high, log] = p.v;
        const value = log ? low * Math.pow(high / low, up) : low + up * (high - low);
        found.push({ value, colour: getComputedStyle(path).stroke });
        break;
      }
    }
    return found;
  };
  const point = (here) => {
    box.hidden = !here;
    for (const p of panels) {
      p.line ??= add(p, 'path', { class: 'cursor-line' });
      const inside = here && here.t >= shown(p)[0] && here.t <= shown(p)[1];
      p.line.setAttribute('d', inside ? `M${x(p, here.t)} ${p.at[1]}V${p.at[3]}` : '');
    }
    if (!here) return;
    box.replaceChildren(`t = ${here.t.toFixed(3)} s`);
    for (const { value, colour } of values(here.p, here.t)) {
      const e = box.appendChild(document.createElement('b'));
      e.textContent = ` ${Number(value.toPrecision(4))}`;
      e.style.color = colour;
    }
  };
  const zoom = (to) => {
    range = to;
    panels.forEach((p, i) => {
      if (!p.data) {
        // The figure of what happened when stays whole, and shows which part is looked at.
        p.part ??= add(p, 'path', { class: 'cursor-part' });
        p.part.setAttribute('d', range ? `M${x(p, range[0])} ${p.at[1]}H${x(p, range[1])}V${p.at[3]}H${x(p, range[0])}Z` : '');
        return;
      }
      const [x0, y0, x1, y1] = p.at;
      if (!p.ends) {
        const clip = add(p, 'clipPath', { id: `clip-${i}` });
        const rect = clip.appendChild(document.createElementNS(NS, 'rect'));
        for (const [key, value] of Object.entries({ x: x0, y: y0, width: x1 - x0, height: y1 - y0 })) rect.setAttribute(key, value);
        const size = parseFloat(p.g.querySelector('text')?.getAttribute('font-size')) || 13;
        p.ends = ['start', 'end'].map((anchor, k) =>
          add(p, 'text', { class: 't', x: k ? x1 : x0, y: y1 + 1.65 * size, 'font-size': size, 'text-anchor': anchor }));
      }
      p.g.classList.toggle('zoomed', !!range);
      p.clip.setAttribute('clip-path', range ? `url(#clip-${i})` : 'none');
      const [from, till] = shown(p);
      const k = (p.t[1] - p.t[0]) / (till - from);
      const left = x0 + ((from - p.t[0]) / (p.t[1] - p.t[0])) * (x1 - x0);
      p.data.setAttribute('transform', range ? `matrix(${k} 0 0 1 ${x0 - k * left} 0)` : '');
      const digits = Math.max(0, Math.min(6, Math.ceil(2 - Math.log10(till - from))));
      p.ends.forEach((e, j) => (e.textContent = range ? range[j].toFixed(digits) : ''));
    });
  };
  let begun = null;
  document.addEventListener('pointermove', (event) => point(under(event)));
  document.addEventListener('pointerdown', (event) => {
    begun = event.pointerType === 'mouse' && event.button === 0 ? under(event) : null;
    if (begun) event.preventDefault();
  });
  document.addEventListener('pointerup', (event) => {
    const end = begun && under(event);
    const from = begun;
    begun = null;
    if (!end) return;
    const [a, b] = [from.t, end.t].sort((m, n) => m - n);
    const [least, most] = shown(from.p);
    // A hundredth of what is shown is a click that shook.
    if (b - a > 0.01 * (most - least)) zoom([a, b]);
  });
  document.addEventListener('dblclick', (event) => under(event) && zoom(null));
  const motion = document.querySelector('[data-from]');
  if (motion) zoom(motion.dataset.from.split(' ').map(Number));
})();
