"""Small OpenDRIVE maps, written out for tests."""

LANE = '<lane id="{id}" type="{type}" {more}><link>{link}</link>{inside}<width sOffset="0" a="{width}" b="0" c="0" d="0"/></lane>'


def lane(id, before=None, after=None, type="driving", width=3.0, more="", inside=""):
    link = "" if before is None else f'<predecessor id="{before}"/>'
    link += "" if after is None else f'<successor id="{after}"/>'
    return id, LANE.format(id=id, type=type, more=more, link=link, inside=inside, width=width)


def section(s, *lanes):
    left = "".join(text for i, text in sorted(lanes, reverse=True) if i > 0)
    right = "".join(text for i, text in sorted(lanes, reverse=True) if i < 0)
    middle = '<center><lane id="0" type="none"/></center>'
    return f'<laneSection s="{s}"><left>{left}</left>{middle}<right>{right}</right></laneSection>'


def link(tag, kind, id, contact=None):
    at = f' contactPoint="{contact}"' if contact else ""
    return f'<{tag} elementType="{kind}" elementId="{id}"{at}/>'


def geometry(s, x, y, hdg, length, shape="<line/>"):
    return f'<geometry s="{s}" x="{x}" y="{y}" hdg="{hdg}" length="{length}">{shape}</geometry>'


def road(
    id,
    length,
    geometries,
    *sections,
    before="",
    after="",
    junction=-1,
    rule='rule="RHT"',
    inside="",
    lanes="",
):
    return (
        f'<road id="{id}" length="{length}" junction="{junction}" {rule}><link>{before}{after}</link>'
        f"<planView>{geometries}</planView>{inside}<lanes>{lanes}{''.join(sections)}</lanes></road>"
    )


def document(*parts, header=""):
    return f'<?xml version="1.0"?><OpenDRIVE><header revMajor="1" revMinor="6">{header}</header>{"".join(parts)}</OpenDRIVE>'
