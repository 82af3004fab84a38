// Files of the operator's machine: opened here and sent as text, written by the server and saved here.

// What the gateway takes in one frame.
const MOST = 200_000;

// The chosen file of an input as { name, text }, or as { error }; nil if none was chosen. The same file can be chosen again.
export async function chosen(input) {
  const [file] = input.files;
  if (!file) return null;
  if (file.size > MOST) {
    input.value = "";
    return { error: `${file.name} is larger than ${MOST / 1000} kB; send it over REST instead` };
  }
  const text = await file.text();
  input.value = "";
  return { name: file.name, text };
}

// All chosen files of an input, as { files: [{ name, text }, …] } that fit into a frame each, and { error } for what does not.
export async function allChosen(input) {
  const parts = [];
  let size = Infinity;
  for (const file of [...input.files]) {
    if (file.size > MOST) {
      parts.push({ error: `${file.name} is larger than ${MOST / 1000} kB; send it over REST instead` });
      continue;
    }
    // Quotes take two bytes in a frame.
    if (size + file.size > MOST / 2) { parts.push({ files: [] }); size = 0; }
    size += file.size;
    parts.findLast((part) => part.files).files.push({ name: file.name, text: await file.text() });
  }
  input.value = "";
  return parts;
}

export function save(name, text, type = "application/octet-stream") {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([text], { type }));
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}
