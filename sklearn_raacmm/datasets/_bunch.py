"""A data set as its user asked for it: arrays or frames, all of it or X, y and groups."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause


def pack(data, return_X_y, as_frame, split_by="groups"):
    """Turn the arrays of a Bunch into pandas objects, and take X, y and groups out, if asked."""
    if as_frame:
        import pandas as pd

        data.data = pd.DataFrame(data.data, columns=data.feature_names)
        data.target = pd.DataFrame(data.target, columns=data.target_names)
        data.groups = pd.Series(data.groups, name="position")
        labels = [data.groups]
        if split_by != "groups":
            data[split_by] = pd.Series(data[split_by], name=split_by.removesuffix("s"))
            labels.append(data[split_by])
        data.frame = pd.concat([data.data, data.target, *labels], axis=1)
    return (data.data, data.target, data[split_by]) if return_X_y else data
