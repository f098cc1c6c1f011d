#!/bin/sh
# Build Lichtblick for look.py from a checkout of its repository: build.sh LICHTBLICK; the result is LICHTBLICK/web/.webpack.
# Needs Node 20. Some of its packages are not in the public npm registry at the versions that it names: those that are
# there take their places (@lichtblick/tsconfig, eslint-plugin, rosbag2 and rosbag2-web at 1.0, flatbuffers_reflection at
# 0.0.7), and what only its desktop app and its own checks need is left out. None of these has to do with MCAP files.
set -eu
here=$(cd "$(dirname "$0")" && pwd)
cd "$1"
sed -i '/yarnPath/d' .yarnrc.yml
sed -i 's/"flatbuffers_reflection": "1.3.0"/"flatbuffers_reflection": "0.0.7"/' packages/mcap-support/package.json
node - <<'END'
const fs = require("fs");
const wanted = JSON.parse(fs.readFileSync("package.json"));
Object.assign(wanted.resolutions, {
  "@lichtblick/tsconfig": "1.0.0", "@lichtblick/eslint-plugin": "1.0.4",
  "@lichtblick/rosbag2-web": "1.0.0", "@lichtblick/rosbag2": "1.0.0",
});
for (const name of ["electron", "electron-builder", "@playwright/mcp", "@storybook/react-webpack5", "storybook",
  "eslint-plugin-storybook", "depcheck", "license-checker", "@actions/core", "@actions/exec", "@actions/tool-cache",
  "@octokit/rest", "@biomejs/biome", "lint-staged"]) delete wanted.devDependencies[name];
wanted.workspaces.packages = wanted.workspaces.packages.filter((name) => name !== "desktop" && name !== "benchmark");
fs.writeFileSync("package.json", JSON.stringify(wanted, null, 2));
END
yarn=$(mktemp -d)
npm install --silent --prefix "$yarn" @yarnpkg/cli-dist@4.17.0
HUSKY=0 YARN_ENABLE_TELEMETRY=0 YARN_ENABLE_IMMUTABLE_INSTALLS=false \
  node "$yarn/node_modules/@yarnpkg/cli-dist/bin/yarn.js" install --mode=skip-build
cp "$here/webpack.config.js" spheremcap.webpack.config.js
NODE_OPTIONS=--max-old-space-size=6144 node_modules/.bin/webpack --mode production --config spheremcap.webpack.config.js
