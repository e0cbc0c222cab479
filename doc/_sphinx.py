"""For `conf.py`: links to other projects' pages, and the order of the gallery."""

import zlib
from pathlib import Path

SKLEARN = "https://scikit-learn.org/stable/"
SCIPY = "https://docs.scipy.org/doc/scipy/"
# Names that we mention, which an inventory of our own knows without a network.
NAMES = {
    SKLEARN: {
        "py:class": [
            "sklearn.compose.TransformedTargetRegressor",
            "sklearn.gaussian_process.GaussianProcessRegressor",
            "sklearn.linear_model.LinearRegression",
            "sklearn.linear_model.OrthogonalMatchingPursuit",
            "sklearn.model_selection.GridSearchCV",
            "sklearn.model_selection.GroupKFold",
            "sklearn.model_selection.LeaveOneGroupOut",
            "sklearn.multioutput.MultiOutputRegressor",
            "sklearn.pipeline.Pipeline",
            "sklearn.preprocessing.StandardScaler",
            "sklearn.preprocessing.TargetEncoder",
            "sklearn.decomposition.TruncatedSVD",
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


class GalleryOrder:
    """Order of the gallery: the main job, real arms, how the method works, then the network."""

    FIRST = (
        "plot_learn_correction",
        "plot_own_csv",
        "plot_simulated_arm",
        "plot_real_arm",
        "plot_real_tracker",
        "plot_how_many_poses",
        "plot_after_the_lab",
        "plot_live_arm",
        "plot_arm_poses",
        "plot_compare_regressors",
        "plot_paper_figures",
        "plot_periodicity",
        "plot_rbf_network",
        "plot_ols_path",
        "plot_grid_search",
        "plot_newrb",
    )

    def __init__(self, source_folder):
        pass

    def __call__(self, filename):
        """Key to sort a file by."""
        stem = Path(filename).stem
        place = self.FIRST.index(stem) if stem in self.FIRST else len(self.FIRST)
        return place, stem
