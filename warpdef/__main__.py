"""``python -m warpdef``: the ``warpdef`` command where its script is not on the path.

It stands beside the library because Python looks for it here, and belongs to the apps: nothing imports it.
"""

from warpdef.apps.main import main

if __name__ == "__main__":
    main()
