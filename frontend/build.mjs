// Bundles the page into ground/web/static (or OUT). The same sources give the same files; all but the page itself are
// named by their content. `--tests` bundles the pure modules' tests into build/frontend-tests instead.

import { build } from "esbuild";
import { createHash } from "node:crypto";
import { cpSync, mkdirSync, readFileSync, readdirSync, rmSync, writeFileSync } from "node:fs";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";
import { gzipSync } from "node:zlib";

const here = dirname(fileURLToPath(import.meta.url));
const EXPORTS = [["geojson", "GeoJSON"], ["kml", "KML"], ["gpx", "GPX"], ["csv", "CSV"], ["cot", "CoT"], ["tak", "TAK data package, with pictures"]];

if (process.argv.includes("--tests")) {
  const out = process.argv[3] ?? join(here, "../build/frontend-tests");
  rmSync(out, { recursive: true, force: true });
  const entryPoints = readdirSync(join(here, "tests")).filter((name) => name.endsWith(".test.ts")).map((name) => join(here, "tests", name));
  await build({ entryPoints, outdir: out, bundle: true, platform: "node", format: "esm", outExtension: { ".js": ".mjs" }, logLevel: "warning" });
} else {
  const out = process.argv[2] ?? join(here, "../ground/web/static");
  rmSync(out, { recursive: true, force: true });
  mkdirSync(out, { recursive: true });
  const hash = (content) => createHash("sha256").update(content).digest("hex").slice(0, 8).toUpperCase();
  const worker = readFileSync(join(here, "node_modules/maplibre-gl/dist/maplibre-gl-worker.mjs"));
  const workerName = `map-worker-${hash(worker)}.js`;
  writeFileSync(join(out, workerName), worker);
  const result = await build({
    entryPoints: { main: join(here, "src/main.ts") },
    outdir: out, entryNames: "[name]-[hash]", chunkNames: "[name]-[hash]", splitting: true, bundle: true, minify: true, format: "esm", target: "es2022",
    define: { WORKER_URL: JSON.stringify(`/${workerName}`) },
    metafile: true, legalComments: "none", logLevel: "warning",
  });
  const names = Object.keys(result.metafile.outputs).map((path) => path.split("/").at(-1));
  const exports_ = EXPORTS.map(([word, title]) => `<li><a href="/api/export/${word}" download data-format="${word}">${title}</a></li>`).join("");
  const page = readFileSync(join(here, "src/index.html"), "utf8")
    .replace("{{css}}", names.find((name) => name.endsWith(".css")))
    .replace("{{js}}", names.find((name) => /^main-.*\.js$/.test(name)))
    .replace("{{exports}}", exports_);
  writeFileSync(join(out, "index.html"), page);
  cpSync(join(here, "src/icon.svg"), join(out, "icon.svg"));
  // The licences of what is bundled travel with it.
  const licences = ["maplibre-gl/LICENSE.txt", "pmtiles/LICENSE", "geomagnetism/LICENSE"].flatMap((path) => {
    try { return [`${path}\n\n${readFileSync(join(here, "node_modules", path), "utf8")}`]; } catch { return []; }
  });
  writeFileSync(join(out, "licences.txt"), licences.join("\n\n"));
  for (const name of readdirSync(out)) {
    if (/\.(js|css|html|svg)$/.test(name)) writeFileSync(join(out, `${name}.gz`), gzipSync(readFileSync(join(out, name)), { level: 9 }));
  }
}
