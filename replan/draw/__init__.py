"""One drawing model (`model`), shown as recordings (`recording`), charts (`charts`) and reports
(`report`).
"""
