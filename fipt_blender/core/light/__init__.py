"""The light room: radiance cache, shadings, emitters and environment."""
