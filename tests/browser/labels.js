// Labels of the page that are clipped, or stand over one another, and first figures that are empty, a line each.
() => {
  const found = [];
  const seen = (element) => element.getClientRects().length > 0 && getComputedStyle(element).visibility !== "hidden";
  for (const svg of document.querySelectorAll("figure svg")) {
    const frame = svg.getBoundingClientRect();
    const boxes = [...svg.querySelectorAll("text")].filter((text) => seen(text) && text.textContent.trim()).map((text) => {
      const parts = text.querySelector("tspan") ? [...text.querySelectorAll("tspan")] : [text];
      const rects = parts.map((part) => part.getBoundingClientRect());
      const [left, top] = [Math.min(...rects.map((rect) => rect.left)), Math.min(...rects.map((rect) => rect.top))];
      const [right, bottom] = [Math.max(...rects.map((rect) => rect.right)), Math.max(...rects.map((rect) => rect.bottom))];
      const stands = bottom - top > right - left;  // a line's box is higher than its letters
      const [dx, dy] = [(stands ? 0.2 : 0.04) * (right - left), (stands ? 0.04 : 0.2) * (bottom - top)];
      return {text: text.textContent.trim().replace(/\s+/g, " "), ends: stands ? [left + dx, right - dx] : [left, right], left: left + dx, right: right - dx, top: top + dy, bottom: bottom - dy};
    });
    for (const [place, a] of boxes.entries()) {
      if (a.ends[0] < frame.left - 1 || a.ends[1] > frame.right + 1 || a.top < frame.top - 1 || a.bottom > frame.bottom + 1) found.push(`clipped: ${a.text}`);
      for (const b of boxes.slice(place + 1)) {
        const [across, down] = [Math.min(a.right, b.right) - Math.max(a.left, b.left), Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top)];
        if (across > 1 && down > 1) found.push(`over one another: ${a.text} | ${b.text}`);
      }
    }
  }
  for (const box of document.querySelectorAll("[data-hero]"))
    if (!box.querySelector("path.signal, path.statistic")) found.push("nothing is drawn of a trial of the first figure");
  for (const element of document.querySelectorAll("h1, h2, h3, p, li, dt, dd, th, td, button, .key, summary, nav a")) {
    if (!seen(element) || element.closest("figure svg")) continue;
    if (element.scrollWidth > element.clientWidth + 1 && element.clientWidth && getComputedStyle(element).display !== "inline")
      found.push(`wider than its place: ${element.textContent.trim().replace(/\s+/g, " ").slice(0, 60)}`);
  }
  if (document.documentElement.scrollWidth > innerWidth) found.push(`the page is ${document.documentElement.scrollWidth} wide`);
  return found;
}
