"""Words of the acceptance sheet in German; English ones are their own keys."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

# Entries of the sheet by their names in the table `sheet`, in their order.
ENTRIES = {
    "number": "number", "laboratory": "laboratory", "customer": "customer",
    "place": "place of the test", "item": "item (maker, model)", "serial": "serial number",
    "probe": "probe", "received": "received", "tested": "tested", "issued": "issued",
    "temperature": "temperature, °C", "humidity": "relative humidity, %",
    "deviations": "deviations from the method", "remarks": "remarks", "operator": "operator",
    "authorised": "authorised by",
}  # fmt: skip

GERMAN = {
    "Acceptance test": "Annahmeprüfung",
    "Sheet": "Blatt", "page": "Seite", "of": "von", "simulated": "simuliert",
    "number": "Nummer", "laboratory": "Laboratorium", "customer": "Auftraggeber",
    "place of the test": "Ort der Prüfung",
    "item (maker, model)": "Gegenstand (Hersteller, Typ)", "serial number": "Seriennummer",
    "probe": "Taster", "received": "Eingang", "tested": "Prüfdatum", "issued": "Ausgabe",
    "temperature, °C": "Temperatur, °C", "relative humidity, %": "relative Luftfeuchte, %",
    "deviations from the method": "Abweichungen vom Verfahren", "remarks": "Bemerkungen",
    "operator": "Prüfer", "authorised by": "freigegeben von",
    "Item, customer and environment": "Gegenstand, Auftraggeber und Umgebung",
    "Artefacts": "Normale", "artefact": "Normal", "size, mm": "Maß, mm",
    "form, µm": "Formabweichung, µm", "fixture, µm": "Aufnahme u, µm",
    "expansion, 10⁻⁶/K": "Ausdehnung, 10⁻⁶/K", "certificate": "Kalibrierschein",
    "Results": "Ergebnisse", "value": "Kenngröße", "after": "nach", "formula": "Formel",
    "test": "Prüfung", "read": "gelesen",
    "as found, µm": "Eingang, µm", "as left, µm": "Ausgang, µm", "limit, µm": "Grenzwert, µm",
    "decision, as found": "Entscheid Eingang", "decision, as left": "Entscheid Ausgang",
    "interval, µm": "Bereich, µm", "not stated": "nicht angegeben",
    "no value": "kein Wert", "Findings": "Befunde", "None.": "Keine.",
    "pass": "bestanden", "conditional pass": "bedingt bestanden",
    "conditional fail": "bedingt nicht bestanden", "fail": "nicht bestanden",
    "Method, uncertainty and decision rule": "Verfahren, Unsicherheit und Entscheidungsregel",
    "Software and fingerprints": "Programm und Prüfsummen", "software": "Programm",
    "fingerprint of the readings": "Prüfsumme der Messwerte",
    "fingerprint of the model": "Prüfsumme des Modells", "signature": "Unterschrift",
    "open secondary source": "freie Sekundärquelle", "common practice": "übliche Praxis",
    "D_fit - D_cal, the worse position": "D_Ausgleich - D_kal, die schlechtere Stellung",
    "r_max - r_min, the worse position": "r_max - r_min, die schlechtere Stellung",
    "diameter of the smallest sphere round 5 centres":
        "Durchmesser der kleinsten Kugel um 5 Mittelpunkte",
    "L - L_cal, the worst of 105": "L - L_kal, die schlechteste von 105",
    "L - L_cal over opposite faces, the worst of 105":
        "L - L_kal über Gegenflächen, die schlechteste von 105",
    "D_fit - D_cal, the worst of 3": "D_Ausgleich - D_kal, die schlechteste von 3",
    "(max - min) / 2, the worst axis": "(max - min) / 2, die schlechteste Achse",
    "max |L - L_cal|": "max |L - L_kal|",
    "max (L - L_cal) - min (L - L_cal)": "max (L - L_kal) - min (L - L_kal)",
    "2 sqrt(sum (L - L_cal)^2 / n)": "2 sqrt(sum (L - L_kal)^2 / n)",
    "|mean - commanded|, the worst pose": "|Mittel - Soll|, die schlechteste Pose",
    "mean l + 3 S_l, the worst pose": "Mittel l + 3 S_l, die schlechteste Pose",
    "makers": "Herstellerangaben",
    "probing": "Antasten", "articulation": "Gelenkstellungen", "length": "Länge",
    "bidirectional": "Länge, beidseitig", "diameter": "Durchmesser",
    "single-point": "Einzelpunkt", "volumetric": "Volumen", "pose": "Pose",
    "near": "nah", "middle": "mittel", "far": "fern", "largest": "größte",
    "half range": "halbe Spanne", "effective": "effektiver", "range": "Spanne",
    "AS_FOUND": "Eingang: der Zustand vor der Justierung. Ausgang: nach der Korrektur (Justierung "
        "durch das Programm); beide aus denselben Messwerten berechnet.",
    "UNCERTAINTY": "U ist die erweiterte Messunsicherheit mit k = 2 (etwa 95 %): die des Prüfers, "
        "aus Normal, Temperatur, Ausdehnung, Form und Aufnahme (nach ISO 14253-5). Was das Gerät "
        "streut, ist die Kenngröße selbst.",
    "INTERVAL": "Bereich: 95 %. χ² heißt, was eine weitere Prüfung änderte; sonst, was das Modell "
        "für die Werte nach der Korrektur erwartet. Größtwerte haben aus einer Prüfung keinen.",
    "guarded": "Entscheidungsregel nach ISO 14253-1, Schutzabstand 1,645 u: bestanden und nicht "
        "bestanden sind mit 95 % nachgewiesen, dazwischen wird bedingt entschieden.",
    "simple": "Entscheidungsregel: einfache Annahme ohne Schutzabstand (ISO 14253-1, Anhang).",
    "CONFORMITY": "Kenngrößen sind nach den genannten Normen benannt, von denen das Genannte "
        "gelesen wurde. Dies ist keine Erklärung der Übereinstimmung mit ihnen. VDI/VDE 2617-9 und "
        "JJF 1408 haben Antasten, Gelenkstellungen und Länge mit ISO 10360-12 gemeinsam.",
    "ONLY": "Die Ergebnisse beziehen sich nur auf diesen Gegenstand. Auszugsweise Wiedergabe nur "
        "mit Genehmigung des Laboratoriums.",
}  # fmt: skip

ENGLISH = {
    "AS_FOUND": "As found: before any adjustment. As left: after the correction (an adjustment by "
        "software); both are computed from the same readings.",
    "UNCERTAINTY": "U is the expanded uncertainty with k = 2 (about 95 %): the tester's, of "
        "artefact, temperature, expansion, form and fixture (after ISO 14253-5). How the arm "
        "scatters is the value itself.",
    "INTERVAL": "Interval: 95 %. χ²: what another test would change; otherwise what the model "
        "expects of the values after correction. Largest values have none from one test.",
    "guarded": "Decision rule of ISO 14253-1 with a guard of 1.645 u: pass and fail are proved "
        "with 95 %; in between the decision is conditional.",
    "simple": "Decision rule: simple acceptance, without a guard (ISO 14253-1).",
    "CONFORMITY": "Values are named after the standards that are stated, of which was read what is "
        "stated. This is no statement of conformance to any of them. VDI/VDE 2617-9 and JJF 1408 "
        "share the probing, articulation and length tests with ISO 10360-12.",
    "ONLY": "The results relate to this item only. To be reproduced in full, unless the laboratory "
        "has approved otherwise.",
}  # fmt: skip


def translator(language):
    """A function from the words of the sheet to those of the language."""
    words = GERMAN if language == "de" else ENGLISH

    def translate(text):
        if text in words or language != "de":
            return words.get(text, text)
        # Names of values and of artefacts, word by word: "2S far", "volumetric 2 rms".
        first, _, rest = text.partition(" ")
        for head in ("half range", "effective diameter"):
            if text.startswith(head):
                first, rest = head, text[len(head) + 1 :]
        first = "effektiver Durchmesser" if first == "effective diameter" else first
        return " ".join(filter(None, [words.get(first, first), words.get(rest, rest)]))

    return translate
