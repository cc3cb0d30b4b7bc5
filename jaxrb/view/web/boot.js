// Unpacks the modules, gives each a blob's address, and starts the last one. A classic script: an import map has to
// stand in the page before the first module is asked for.
"use strict";
(() => {
  const text = (id) => document.getElementById(id).textContent;

  const unpacked = async (packed) => {
    const bytes = Uint8Array.from(atob(packed.trim()), (c) => c.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
    return new Uint8Array(await new Response(stream).arrayBuffer());
  };

  const tell = (problem) => {
    const message = document.getElementById("message");
    message.textContent = problem;
    message.hidden = false;
  };

  const start = async () => {
    if (!("DecompressionStream" in window)) {
      return tell("This browser is too old for the viewer: it needs one of 2023 or later.");
    }
    const modules = JSON.parse(new TextDecoder().decode(await unpacked(text("program"))));
    const imports = {};
    for (const [name, source] of Object.entries(modules)) {
      imports[name] = URL.createObjectURL(new Blob([source], { type: "text/javascript" }));
    }
    const map = document.createElement("script");
    map.type = "importmap";
    map.textContent = JSON.stringify({ imports });
    document.head.append(map);
    const { main } = await import("jaxrb/main");
    return main(JSON.parse(text("record")), (await unpacked(text("numbers"))).buffer);
  };

  window.jaxrb = {};
  window.jaxrb.ready = start().catch((error) => {
    tell(`The viewer could not start: ${error.message}`);
    throw error;
  });
})();
