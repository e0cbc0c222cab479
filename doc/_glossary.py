"""For `conf.py`: links to the glossary where a page uses a term first."""

import re

from docutils import nodes

# Terms that every page is about, and words that mean something else in most sentences.
_NO_LINK = {
    *("`x`", "`y`", "pose", "position", "gravity", "width", "centre", "order", "goal", "guard"),
    *("ridge", "deviation"),
}


def terms_of(glossary):
    """Anchor of each term of the glossary's tree by its words, which get these anchors here."""
    found = {}
    for term in glossary.findall(nodes.term):
        words = re.sub(r"\(.*?\)", "", term.astext()).split(",")
        if not term["ids"]:
            term["ids"].append(nodes.make_id(f"term {words[0]}"))
        names = (word.strip() for word in words)
        found |= {name: term["ids"][0] for name in names if name.lower() not in _NO_LINK}
    return found


def link_terms(tree, terms, uri):
    """Link the first use of each term in the running text of a page to the glossary at `uri`."""
    left = dict(sorted(terms.items(), key=lambda one: -len(one[0])))
    others = nodes.reference | nodes.literal | nodes.title | nodes.term | nodes.math | nodes.caption
    for text in list(tree.findall(nodes.Text)):
        above, inside = text.parent, []
        while above is not None:
            inside.append(above)
            above = above.parent
        if not any(isinstance(one, nodes.paragraph) for one in inside):
            continue
        if any(isinstance(one, others) for one in inside):
            continue
        parts = _linked(text.astext(), left, uri)
        if len(parts) > 1:
            text.parent.replace(text, parts)


def _linked(text, left, uri):
    """A text as nodes, with links at the first use of the terms that are `left`; these go."""
    for name, anchor in left.items():
        ending = "" if name[-1].isdigit() or name.isupper() else "s?"
        place = re.search(rf"(?<![\w-]){re.escape(name)}{ending}(?![\w-])", text, re.IGNORECASE)
        if place:
            for other in [one for one, at in left.items() if at == anchor]:
                del left[other]
            link = nodes.reference(place[0], place[0], refuri=f"{uri}#{anchor}", internal=True)
            link["classes"].append("term")
            before, after = text[: place.start()], text[place.end() :]
            return [*_linked(before, left, uri), link, *_linked(after, left, uri)]
    return [nodes.Text(text)] if text else []
