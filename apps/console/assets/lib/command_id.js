// The id of one command: made once, when its button is pressed, so that the gateway would know a second one of the same press.
export function commandId() {
  const bytes = crypto.getRandomValues(new Uint8Array(12));
  return "web-" + Array.from(bytes, (byte) => byte.toString(16).padStart(2, "0")).join("");
}
