// Whoever has no mouse scrolls a wide table or a long line of code with the arrow keys, once it has the focus.
const WIDE = ".md-typeset__scrollwrap, .md-typeset pre > code, .md-typeset math[display=block]";

function reach() {
  for (const part of document.querySelectorAll(WIDE)) {
    if (part.scrollWidth > part.clientWidth) part.setAttribute("tabindex", "0");
    else part.removeAttribute("tabindex");
  }
}

addEventListener("load", reach);
addEventListener("resize", reach);
document.addEventListener("toggle", reach, true);  // a fold that opens
