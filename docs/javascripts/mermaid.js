// Material for MkDocs uses `window.mermaid` where it is defined, and loads a copy from another host where it is not.
// This one loads the site's copy (see scripts/site/docs_hook.py) when a page has its first diagram.
(() => {
  const library = new URL("mermaid/index.js", document.currentScript.src).href;
  let options = {};
  window.mermaid = {
    initialize(given) { options = given; },
    async render(id, text) {
      try {
        const { mermaid } = await import(library);
        mermaid.initialize(options);
        return await mermaid.render(id, text);
      } catch (error) { // a browser loads no modules from the file system: show the diagram's source
        console.warn(error);
        const source = document.createElement("pre");
        source.textContent = text;
        return { svg: source.outerHTML };
      }
    },
  };
})();
