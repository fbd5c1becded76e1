'use strict';
// Numbers come as server-sent events, images one by one as they are asked for. Whatever is shown goes into the page as text, never as markup.
const NS = 'http://www.w3.org/2000/svg';
const SILENT_MS = 3000; // three messages that did not come
const MOST_ERRORS = 1500, MOST_EVENTS = 100; // as many as the watcher keeps
let facts = null, errors = [], events = [], lastMessage = 0, stream = null, shownImage = null;
const at = id => document.getElementById(id);
const query = more => '?' + [location.search.slice(1), more].filter(Boolean).join('&');
const number = (x, decimals) => x === null || x === undefined ? '–' : x.toFixed(decimals);
const unit = (x, decimals, name) => x === null || x === undefined ? '–' : x.toFixed(decimals) + ' ' + name;
const percent = x => x === null || x === undefined ? '–' : Math.min(999, 100 * x).toFixed(0) + ' %';

function element(name, text, kind) {
  const e = document.createElement(name);
  if (text !== undefined) e.textContent = text;
  if (kind) e.className = kind;
  return e;
}
function drawn(name, attributes, text) {
  const e = document.createElementNS(NS, name);
  for (const key in attributes) e.setAttribute(key, attributes[key]);
  if (text !== undefined) e.textContent = text;
  return e;
}
function list(id, pairs) {
  at(id).replaceChildren(...pairs.map(([name, value]) => {
    const row = element('div');
    row.append(element('dt', name), element('dd', value));
    return row;
  }));
}
function row(cells, head) {
  const r = element('tr');
  for (const [content, kind] of cells) {
    const cell = element(head ? 'th' : 'td', typeof content === 'string' ? content : undefined, kind);
    if (typeof content !== 'string') cell.append(content);
    r.append(cell);
  }
  return r;
}

function showPlane(now) {
  const [width, height] = facts.image_px, plane = at('plane'), size = Math.max(width, height) / 90;
  plane.setAttribute('viewBox', `-0.5 -0.5 ${width} ${height}`);
  at('image').style.aspectRatio = `${width} / ${height}`;
  const parts = now.trails.filter(t => t.length > 1).map(t =>
    drawn('path', { class: 'trail', d: 'M' + t.map(p => p.join(' ')).join('L') }));
  for (const [, u, v] of now.goal_points) parts.push(drawn('circle', { class: 'goal', cx: u, cy: v, r: size * 1.2 }));
  for (const [id, u, v] of now.features) {
    parts.push(drawn('path', { d: `M${u - size} ${v}H${u + size}M${u} ${v - size}V${v + size}` }));
    if (now.features.length <= 8) parts.push(drawn('text', { x: u + size * 1.4, y: v - size, 'font-size': size * 2.4 }, String(id + 1)));
  }
  plane.replaceChildren(...parts);
  const first = now.features[0];
  at('place').textContent = first ? `point ${first[0] + 1}: ${first[1].toFixed(1)} ${first[2].toFixed(1)} px` : 'no point is seen';
}

function showCurve() {
  const svg = at('curve'), box = svg.getBoundingClientRect(), w = box.width, h = box.height;
  const left = 52, bottom = 24, top = 8, right = 10, tolerance = facts.tolerance_px;
  const shown = errors.filter(e => e[0] !== null && e[1] > 0);
  const all = shown.map(e => e[1]).concat(tolerance > 0 ? [tolerance] : []);
  const parts = [];
  if (all.length > 0 && w > left + right) {
    let low = Math.floor(Math.log10(Math.min(...all))), high = Math.ceil(Math.log10(Math.max(...all)));
    if (high <= low) high = low + 1;
    const t1 = shown.length ? shown[shown.length - 1][0] : 1, t0 = shown.length ? Math.min(shown[0][0], t1 - 1) : 0;
    const x = t => left + (t - t0) / (t1 - t0) * (w - left - right);
    const y = e => top + (high - Math.log10(e)) / (high - low) * (h - top - bottom);
    for (let decade = low; decade <= high; decade++) {
      const yy = y(10 ** decade);
      parts.push(drawn('path', { class: 'grid', d: `M${left} ${yy}H${w - right}` }),
        drawn('text', { class: 't tm', x: left - 6, y: yy + 4, 'text-anchor': 'end' }, String(+(10 ** decade).toPrecision(1))));
    }
    for (const part of [0, 0.5, 1]) {
      const t = t0 + part * (t1 - t0), anchor = ['start', 'middle', 'end'][part * 2];
      parts.push(drawn('text', { class: 't tm', x: x(t), y: h - 6, 'text-anchor': anchor }, t.toFixed(t1 - t0 < 10 ? 1 : 0) + (part === 1 ? ' s' : '')));
    }
    if (tolerance > 0) parts.push(drawn('path', { class: 'limit', d: `M${left} ${y(tolerance)}H${w - right}` }));
    if (shown.length > 1) parts.push(drawn('path', { class: 'line c0', d: 'M' + shown.map(e => `${x(e[0]).toFixed(1)} ${y(e[1]).toFixed(1)}`).join('L') }));
  }
  svg.replaceChildren(...parts);
  at('curve-note').textContent = `px, logarithmic, of the last ${errors.length} measurements; dotted: the tolerance, ${tolerance} px`;
}

function bar(share, kind, mark) {
  const b = element('div', undefined, 'bar' + (kind ? ' ' + kind : ''));
  if (share !== null) {
    const i = element(mark ? 'i' : 'u');
    i.style[mark ? 'left' : 'width'] = 100 * Math.min(1, Math.max(0, share)) + '%';
    b.append(i);
  }
  return b;
}

function showJoints(joints) {
  const rows = joints.map(j => {
    const bounded = j.lower !== null && j.upper !== null && j.position !== null;
    const share = bounded ? (j.position - j.lower) / (j.upper - j.lower) : null;
    const acts = j.limits.length > 0, name = element('span', j.name, acts ? 'acts' : '');
    name.title = acts ? 'acts on it: ' + j.limits.join(', ') : '';
    const place = bar(share, acts ? 'acts' : '', true);
    if (bounded) place.title = `${j.lower.toFixed(1)} to ${j.upper.toFixed(1)} ${j.unit}`;
    return row([[name], [place], [unit(j.position, 2, j.unit), 'n'], [percent(j.speed_share), 'n'], [percent(j.effort_share), 'n']]);
  });
  const acting = joints.filter(j => j.limits.length > 0).map(j => `${j.name}: ${j.limits.join(', ')}`);
  const note = element('td', acting.length ? 'limits that act: ' + acting.join('; ') : 'no limit acts', acting.length ? 'acts' : 'note');
  note.colSpan = 5;
  const last = element('tr');
  last.append(note);
  at('joints').replaceChildren(row([['joint'], ['range'], ['position', 'n'], ['speed', 'n'], ['effort', 'n']], true), ...rows, last);
}

function showTicks(t) {
  const counts = t.counts, most = Math.log1p(Math.max(1, ...counts));
  at('ticks-note').textContent = counts.length
    ? `p50 ${number(t.p50_us, 0)}, p99 ${number(t.p99_us, 0)}, max ${number(t.max_us, 0)} us; ${t.missed} deadlines missed` + (t.unseen ? `; ${t.unseen} ticks not seen here` : '')
    : facts.lockstep ? 'ticks have no deadline in simulated time' : 'no tick yet';
  at('ticks').replaceChildren(...counts.map((count, i) => {
    const edge = facts.edges_us[i], words = edge === undefined ? `above ${facts.edges_us[i - 1]} us` : `up to ${edge} us`;
    const b = bar(Math.log1p(count) / most, '', false);
    if (edge === undefined || edge > 1000) b.firstChild.className = 'late';
    return row([[words, 'n'], [b], [String(count), 'n']]);
  }));
}

function showEvents(fresh) {
  for (const [time, what] of fresh) {
    const li = element('li', undefined, what.startsWith('fault') ? 'fault' : '');
    li.append(element('span', unit(time, 3, 's')), element('span', what));
    at('events').prepend(li);
  }
  while (at('events').childElementCount > MOST_EVENTS) at('events').lastChild.remove();
}

function show(message) {
  const now = message.now, verdict = document.querySelector('.verdict');
  if (!now || !facts) {
    at('state').textContent = 'no run';
    at('waits').textContent = message.word;
    verdict.className = 'verdict doubt';
    return;
  }
  at('state').textContent = now.ended ? now.outcome || 'ended' : now.state;
  at('waits').textContent = now.ended && now.reason ? `${now.reason}; ${now.waits_for}` : now.waits_for;
  const isBad = now.state === 'fault' || now.outcome === 'fault' || now.outcome === 'not_converged';
  verdict.className = 'verdict' + (isBad ? ' bad' : now.is_good || now.outcome ? '' : ' doubt');
  document.title = `${now.ended ? 'ended' : now.state} · ${facts.instance} · vservo watch`;
  errors = errors.concat(message.errors).slice(-MOST_ERRORS);
  showPlane(now);
  showCurve();
  const pairs = [['time of the run', unit(now.time_s, 1, 's')], ['feature error', unit(now.feature_error_px, 3, 'px')]];
  if (now.position_error_mm !== null) pairs.push(['camera to goal', `${now.position_error_mm.toFixed(2)} mm, ${number(now.orientation_error_deg, 3)} deg`]);
  pairs.push(['goal', now.target_name === null ? String(now.goal) : `${now.goal} of the target ${now.target_name}`]);
  if (now.robot) pairs.push(['robot', now.robot.words]);
  if (now.outcome) pairs.push(['outcome', now.outcome]);
  if (now.is_degraded) pairs.push(['target', 'a part is hidden']);
  list('errors', pairs);
  showJoints(now.joints);
  const s = now.stages;
  list('stages', [['exposure to frame', unit(s.exposure_ms, 1, 'ms')], ['wait for vision', unit(s.wait_ms, 1, 'ms')], ['vision', unit(s.vision_ms, 1, 'ms')],
    ['vision to command', unit(s.control_ms, 1, 'ms')], ['exposure to command', s.p50_ms === null ? '–' : `p50 ${number(s.p50_ms, 1)}, p99 ${number(s.p99_ms, 1)}, max ${number(s.max_ms, 1)} ms`]]);
  const cameras = [['frames', `${now.frames}, ${now.frames_dropped} skipped`], ['target', `${now.target || 'not looked for yet'}, lost ${now.target_lost} times`], ['reprojection', unit(now.reprojection_rms_px, 2, 'px')]];
  if (now.blind_for_s !== null) cameras.push(['no measurement for', unit(now.blind_for_s, 1, 's')]);
  if (now.restarts[0] + now.restarts[1] > 0) cameras.push(['started anew', `camera ${now.restarts[0]}, vision ${now.restarts[1]} times`]);
  for (const c of now.health) cameras.push([`camera ${c.camera}`, [c.state, unit(c.rate_hz, 1, 'Hz'), `${c.lost} lost`, ...c.doubts].join(', ')]);
  list('cameras', cameras);
  showTicks(now.ticks);
  at('processes').replaceChildren(row([['process'], ['pid', 'n'], ['of a core', 'n'], ['memory', 'n']], true),
    ...now.processes.map(p => row([[p.role], [String(p.pid), 'n'], [p.core_share === null ? '–' : (100 * p.core_share).toFixed(1) + ' %', 'n'], [unit(p.memory_mb, 1, 'MB'), 'n']])));
  showEvents(message.events);
}

function connect() {
  stream = new EventSource('events' + query());
  stream.addEventListener('run', event => {
    facts = JSON.parse(event.data);
    errors = [];
    at('events').replaceChildren();
    at('image').removeAttribute('src');
    document.querySelector('h1').textContent = `vservo watch · ${facts.instance}`;
  });
  stream.onmessage = event => {
    lastMessage = Date.now();
    show(JSON.parse(event.data));
    const kind = facts ? `${facts.serves ? 'served' : 'run'}, ${facts.lockstep ? 'simulated' : 'real'} time` : '';
    at('link').textContent = 'live' + (kind ? ' · ' + kind : '');
    at('link').className = '';
  };
  // A stream that was refused does not come back by itself.
  stream.onerror = () => { if (stream.readyState === EventSource.CLOSED) setTimeout(connect, 2000); };
}

async function images() {
  let seen = 0;
  const pause = ms => new Promise(done => setTimeout(done, ms));
  for (;;) {
    try {
      // one that nobody looks at is not asked for
      if (document.hidden) { await pause(500); continue; }
      const answer = await fetch('image.png' + query('after=' + seen), { cache: 'no-store' });
      if (answer.status === 200) {
        seen = +answer.headers.get('X-Image');
        const url = URL.createObjectURL(await answer.blob()), before = shownImage;
        at('image').src = shownImage = url;
        await at('image').decode().catch(() => {});
        if (before) URL.revokeObjectURL(before);
        await pause(60); // with the way there and back, five to ten a second
      } else if (answer.status !== 204) await pause(2000);
    } catch { await pause(2000); }
  }
}

setInterval(() => {
  if (Date.now() - lastMessage > SILENT_MS) {
    at('link').textContent = 'no connection to vservo watch: what is shown is old; it tries again';
    at('link').className = 'bad';
  }
}, 1000);
addEventListener('resize', () => { if (facts) showCurve(); });
connect();
images();
