// What `uplot.js` is served with (vendor/README.md), for the type checker only.

import uPlot from "uplot";
export default uPlot;
