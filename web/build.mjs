// Bundles the page into the Python package that serves it.
import { build } from "esbuild";
import { copyFile, mkdir } from "node:fs/promises";

const out = new URL("../agents/headset/page/", import.meta.url).pathname;
await mkdir(out, { recursive: true });
await build({
  absWorkingDir: new URL(".", import.meta.url).pathname,
  entryPoints: ["src/live.js"],
  bundle: true,
  minify: true,
  format: "esm",
  target: "es2022",
  legalComments: "inline",
  outfile: `${out}live.js`,
});
await copyFile(new URL("index.html", import.meta.url), `${out}index.html`);
console.log(`built ${out}`);
