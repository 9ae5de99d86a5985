// Function of the least contrast: counts the texts of the page, and returns those whose contrast with
// their background is lower, by WCAG 2, as "ratio text | colours | classes".
(least) => {
  const canvas = document.createElement("canvas").getContext("2d", { willReadFrequently: true });
  canvas.canvas.width = canvas.canvas.height = 1;
  const known = new Map();
  // Colours may be written in any colour space; drawn, they are red, green, blue and alpha.
  const rgba = (text) => {
    if (!known.has(text)) {
      canvas.clearRect(0, 0, 1, 1);
      canvas.fillStyle = text;
      canvas.fillRect(0, 0, 1, 1);
      const [r, g, b, a] = canvas.getImageData(0, 0, 1, 1).data;
      known.set(text, [r, g, b, a / 255]);
    }
    return known.get(text);
  };
  const over = ([r, g, b, a], under) => [r, g, b].map((c, i) => a * c + (1 - a) * under[i]);
  const luminance = (rgb) => {
    const [r, g, b] = rgb.map((c) => c / 255).map((c) => (c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4));
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const ratio = (first, second) => {
    const [light, dark] = [luminance(first), luminance(second)].sort((a, b) => b - a);
    return (light + 0.05) / (dark + 0.05);
  };
  // The colour behind an element: the backgrounds of its ancestors, from the page inwards.
  const behind = (element) => {
    const chain = [];
    for (let node = element; node; node = node.parentElement) chain.unshift(node);
    // A dialog in the top layer covers the page with its own background.
    return chain.reduce((under, node) => over(rgba(getComputedStyle(node).backgroundColor), under), rgba("Canvas").slice(0, 3));
  };
  // The text of a half-transparent element is mixed with the colour behind the element.
  const faded = (element, text) => {
    let colour = text;
    for (let node = element; node; node = node.parentElement) {
      const opacity = Number(getComputedStyle(node).opacity);
      if (opacity < 1) colour = over([...colour, opacity], node.parentElement ? behind(node.parentElement) : colour);
    }
    return colour;
  };
  const low = new Map();
  const check = (element, text, colour) => {
    const under = behind(element);
    const shown = faded(element, over(rgba(colour), under));
    const contrast = ratio(shown, under);
    if (contrast < least) {
      const key = `${contrast.toFixed(2)} ${text.trim().slice(0, 30)} | ${shown.map(Math.round)} on ${under.map(Math.round)} | ${element.tagName}.${element.getAttribute("class") ?? ""}`;
      low.set(`${element.tagName}.${element.getAttribute("class")}`, key);
    }
  };
  let texts = 0;
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) {
    const element = walker.currentNode.parentElement;
    if (!walker.currentNode.textContent.trim() || !element.getClientRects().length) continue;
    if (["SCRIPT", "STYLE", "NOSCRIPT"].includes(element.tagName)) continue;
    if (element.closest(":disabled") || !element.checkVisibility({ visibilityProperty: true })) continue;
    const style = getComputedStyle(element);
    check(element, walker.currentNode.textContent, element instanceof SVGElement ? style.fill : style.color);
    texts += 1;
  }
  for (const field of document.querySelectorAll("input[placeholder]")) {
    if (field.getClientRects().length) check(field, field.placeholder, getComputedStyle(field, "::placeholder").color);
  }
  return { texts, low: [...low.values()] };
}
