// Lichtblick's own web build, without type checks, source maps and minifying: only to look at recordings.
const esbuild = require("esbuild");
const fs = require("fs");
const Module = require("module");
for (const ending of [".ts", ".tsx"]) {
  Module._extensions[ending] = (module, file) =>
    module._compile(esbuild.transformSync(fs.readFileSync(file, "utf8"), { loader: ending.slice(1), format: "cjs" }).code, file);
}
const path = require("path");
const { mainConfig } = require("@lichtblick/suite-web/src/webpackConfigs");
const make = mainConfig({
  outputPath: path.resolve(__dirname, "web/.webpack"),
  contextPath: path.resolve(__dirname, "web/src"),
  entrypoint: "./entrypoint.tsx", prodSourceMap: false, version: require("./package.json").version,
});
module.exports = (env, argv) => {
  const config = make(env, argv);
  config.plugins = config.plugins.filter((plugin) => !/ForkTsChecker/.test(plugin.constructor.name));
  for (const rule of config.module.rules) {
    if (String(rule.test) === String(/\.tsx?$/)) {
      const raw = { compilerOptions: { experimentalDecorators: true, useDefineForClassFields: false } };
      rule.use = [{ loader: "esbuild-loader", options: { target: "es2022", jsx: "automatic", tsconfigRaw: raw } }];
    }
  }
  config.optimization = { ...config.optimization, minimize: false };
  return config;
};
