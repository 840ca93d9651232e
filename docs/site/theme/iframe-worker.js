// Browsers start no workers in pages opened from a folder: there a hidden frame runs the program of the search.
if (location.protocol === "file:") window.Worker = class extends EventTarget {
  constructor(url) {
    super();
    this.waiting = [];
    this.frame = document.createElement("iframe");
    this.frame.hidden = true;
    document.body.appendChild(this.frame);
    const inside = this.frame.contentWindow;
    inside.document.open();
    inside.document.write("<!doctype html><body></body>");
    inside.document.close();
    inside.postMessage = (data) => {  // what the program answers
      const event = new MessageEvent("message", { data });
      this.dispatchEvent(event);
      if (this.onmessage) this.onmessage(event);
    };
    inside.importScripts = (...scripts) => scripts.reduce((before, one) => before.then(() => this.load(new URL(one, url).href)), Promise.resolve());
    this.load(url).then(() => { this.ready = true; this.waiting.splice(0).forEach((data) => this.hand(data)); });
  }
  load(url) {
    return new Promise((done, failed) => {
      const script = this.frame.contentDocument.createElement("script");
      Object.assign(script, { src: url, onload: done, onerror: failed });
      this.frame.contentDocument.body.appendChild(script);
    });
  }
  hand(data) { this.frame.contentWindow.dispatchEvent(new MessageEvent("message", { data })); }
  postMessage(data) { if (this.ready) this.hand(data); else this.waiting.push(data); }
  terminate() { this.frame.remove(); }
};
