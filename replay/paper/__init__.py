"""The experiments of the paper: figures, controllers compared, the pedestrian varied (`replan paper`)."""
