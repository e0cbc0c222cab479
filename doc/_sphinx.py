"""For `conf.py`: links to other projects' pages, and the order of the gallery."""

import zlib
from pathlib import Path

SKLEARN = "https://scikit-learn.org/stable/"
SCIPY = "https://docs.scipy.org/doc/scipy/"
# Names that we mention, which an inventory of our own knows without a network.
NAMES = {
    SKLEARN: {
        "py:class": [
            "sklearn.compose.ColumnTransformer",
            "sklearn.compose.TransformedTargetRegressor",
            "sklearn.decomposition.TruncatedSVD",
            "sklearn.gaussian_process.GaussianProcessRegressor",
            "sklearn.linear_model.LinearRegression",
            "sklearn.linear_model.OrthogonalMatchingPursuit",
            "sklearn.model_selection.GridSearchCV",
            "sklearn.model_selection.GroupKFold",
            "sklearn.model_selection.HalvingGridSearchCV",
            "sklearn.model_selection.LeaveOneGroupOut",
            "sklearn.multioutput.MultiOutputRegressor",
            "sklearn.pipeline.Pipeline",
            "sklearn.preprocessing.PowerTransformer",
            "sklearn.preprocessing.StandardScaler",
            "sklearn.preprocessing.TargetEncoder",
            "sklearn.exceptions.NotFittedError",
            "sklearn.utils.Bunch",
            "sklearn.utils.metadata_routing.MetadataRequest",
            "sklearn.utils.metadata_routing.MetadataRouter",
        ],
        "py:function": [
            "sklearn.datasets.get_data_home",
            "sklearn.metrics.make_scorer",
            "sklearn.metrics.r2_score",
            "sklearn.model_selection.cross_val_predict",
            "sklearn.model_selection.cross_val_score",
        ],
    },
    SCIPY: {
        "py:class": ["scipy.interpolate.RBFInterpolator", "scipy.spatial.transform.Rotation"],
    },
}


def write_inventories(folder):
    """Write one inventory a project; return intersphinx's mapping."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    mapping = {}
    for url, names in NAMES.items():
        project = "scipy" if url == SCIPY else "sklearn"
        page = "reference/generated/$.html#$" if url == SCIPY else "modules/generated/$.html#$"
        lines = [
            f"{name} {role} 1 {page.replace('$', name)} -\n"
            for role, of in names.items()
            for name in of
        ]
        if url == SKLEARN:
            # Sections that docstrings which we inherit point to.
            lines += [
                f"{label} std:label -1 {page} {title}\n"
                for label, page, title in (
                    ("r2_score", "modules/model_evaluation.html#r2-score", "R2 score"),
                    ("df_output_transform", "modules/df_output_transform.html", "set_output"),
                    ("metadata_routing", "metadata_routing.html", "Metadata routing"),
                    (
                        "sphx_glr_auto_examples_miscellaneous_plot_set_output.py",
                        "auto_examples/miscellaneous/plot_set_output.html",
                        "set_output",
                    ),
                )
            ]
        head = (
            "# Sphinx inventory version 2\n"
            f"# Project: {project}\n# Version: \n"
            "# The remainder of this file is compressed using zlib.\n"
        )
        path = folder / f"{project}.inv"
        path.write_bytes(head.encode() + zlib.compress("".join(lines).encode()))
        mapping[project] = (url, str(path))
    return mapping


# Sections of the gallery and the examples of each, in order.
SECTIONS = {
    "Correct an arm": ("plot_learn_correction", "plot_own_csv", "plot_simulated_arm"),
    "Real robots": ("plot_real_arm", "plot_real_tracker"),
    "Plan, use and maintain": ("plot_how_many_poses", "plot_live_arm", "plot_after_the_lab"),
    "The published method": (
        "plot_paper_figures",
        "plot_compare_regressors",
        "plot_grid_search",
        "plot_periodicity",
    ),
    "The network by itself": ("plot_rbf_network", "plot_ols_path", "plot_newrb"),
}
_OPEN = '.. raw:: html\n\n    <div class="sphx-glr-thumbnails">\n'
_CLOSE = ".. raw:: html\n\n    </div>\n"


class GalleryOrder:
    """Order of the gallery: that of its sections."""

    def __init__(self, source_folder):
        pass

    def __call__(self, filename):
        """Key to sort a file by."""
        stem = Path(filename).stem
        names = [name for section in SECTIONS.values() for name in section]
        return names.index(stem) if stem in names else len(names), stem


def with_sections(text):
    """Text of the gallery's page, its pictures in one block for each section."""
    head, rest = text.split(_OPEN)
    pictures, tail = rest.split(".. thumbnail-parent-div-close")
    start = '.. raw:: html\n\n    <div class="sphx-glr-thumbcontainer"'
    pictures = [start + picture for picture in pictures.split(start)[1:]]
    blocks = []
    for title, names in SECTIONS.items():
        own = [p for p in pictures if any(f"/{name}`" in p for name in names)]
        pictures = [p for p in pictures if p not in own]
        blocks.append(f"{title}\n{'-' * len(title)}\n\n{_OPEN}\n{''.join(own)}\n{_CLOSE}\n")
    if pictures:
        raise ValueError(f"{len(pictures)} examples are in no section of doc/_sphinx.py.")
    return head + "\n".join(blocks) + tail.split(_CLOSE, 1)[1]
