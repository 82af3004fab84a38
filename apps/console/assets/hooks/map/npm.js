// Where the files of npm packages are served.
const ROOT = new URL("../../npm/", import.meta.url);

export const npm = (path) => new URL(path, ROOT).href;
