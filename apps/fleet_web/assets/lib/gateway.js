// Says within two seconds when the gateway does not answer, whatever the reason: a question every 600 ms, to be answered within 1200. The
// socket's process answers, so the page itself is not troubled. Time in which the browser held the page still does not count.
const ASK_MS = 600;
const PATIENCE_MS = 1200;

export function watch(liveSocket) {
  const root = document.documentElement;
  const banner = document.getElementById("gateway-lost");
  const age = document.getElementById("gateway-lost-age");
  const socket = liveSocket.getSocket();
  let answered = performance.now();
  let woken = answered;
  let looked = answered;

  function look() {
    const now = performance.now();
    if (now - looked > 4 * ASK_MS) woken = now;
    looked = now;
    socket.ping?.(() => { answered = performance.now(); show(); });
    show();
  }

  function show() {
    const now = performance.now();
    const lost = now - Math.max(answered, woken) > PATIENCE_MS;
    if (lost) age.textContent = words(now - answered);
    if (lost === !banner.hidden) return;
    banner.hidden = !lost;
    root.classList.toggle("gateway-lost", lost);
    window.dispatchEvent(new CustomEvent("gateway", { detail: { lost } }));
  }

  socket.onOpen(() => { answered = performance.now(); show(); });
  setInterval(look, ASK_MS);
}

function words(ms) {
  const seconds = Math.floor(ms / 1000);
  return seconds < 100 ? `${seconds} s` : `${Math.floor(seconds / 60)} min`;
}
