// Says within two seconds when the gateway does not answer, whatever the reason: a question every 600 ms, and lost when two of them are open
// at the third. The socket's process answers, so the page itself is not troubled. Questions are counted and not the time, because a browser
// that held the page still has asked nothing meanwhile, and may have the answer waiting.
//
// It is back when the page shows new values: an open socket alone answers for a page that has not joined again, whose buttons do nothing. The
// client marks the page as connected once it has drawn what the join brought. A page that keeps failing behind an open socket is lost as well.
//
// A page that was loaded and is not live yet says so itself: its buttons are disabled (Aerie.Console.Layout) until it is.
const ASK_MS = 600;
const OPEN = 2;

export function watch(liveSocket) {
  const root = document.documentElement;
  const banner = document.getElementById("gateway-lost");
  const age = document.getElementById("gateway-lost-age");
  const socket = liveSocket.getSocket();
  const page = (state) => document.querySelector(`[data-phx-main].phx-${state}`) !== null;
  let fresh = performance.now();
  let open = 0;
  let failing = 0;
  let live = false;
  let lost = false;

  function hear() {
    open = 0;
    show();
  }

  function look() {
    begin();
    failing = page("error") ? failing + 1 : 0;
    show();
    open += 1;
    socket.ping?.(hear);
  }

  // The hooks of a page are mounted when it is connected.
  function begin() {
    if (live || !page("connected")) return;
    live = true;
    document.getElementById("controls").disabled = false;
    root.classList.remove("connecting");
    hear();
  }

  function show() {
    lost = live && (open >= OPEN || failing >= OPEN || (lost && !page("connected")));
    if (open === 0 && page("connected")) fresh = performance.now();
    if (lost) age.textContent = words(performance.now() - fresh);
    if (lost === !banner.hidden) return;
    banner.hidden = !lost;
    root.classList.toggle("gateway-lost", lost);
    window.dispatchEvent(new CustomEvent("gateway", { detail: { lost } }));
  }

  window.addEventListener("phx:page-loading-stop", () => { begin(); show(); });
  socket.onOpen(hear);
  setInterval(look, ASK_MS);
}

function words(ms) {
  const seconds = Math.floor(ms / 1000);
  return seconds < 100 ? `${seconds} s` : `${Math.floor(seconds / 60)} min`;
}
