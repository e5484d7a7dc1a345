"""The experiments of the paper: figures, a comparison of controllers, variations of the pedestrian
(`replan paper`).
"""
