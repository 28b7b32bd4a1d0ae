"""Line plots on log axes as SVG, for other scripts. Standard library only."""

import math

COLOURS = ["#1b6ca8", "#c46210", "#5b2a86", "#2e7d32", "#b3261e", "#555"]


class LogPlot:
    """One pair of log axes, each over powers of ten."""

    def __init__(self, title, across, up, x_powers, y_powers, width=640, height=400):
        self.x_powers, self.y_powers = x_powers, y_powers
        self.left, self.right, self.top, self.bottom = 70, width - 170, 36, height - 50
        self.width, self.height, self.lines = width, height, 0
        middle, centre = (self.left + self.right) / 2, (self.top + self.bottom) / 2
        self.parts = [f'<text x="{middle}" y="20" text-anchor="middle" font-weight="bold">{title}</text>',
                      f'<text x="{middle}" y="{self.bottom + 40}" text-anchor="middle">{across}</text>',
                      f'<text x="16" y="{centre}" transform="rotate(-90 16 {centre})" text-anchor="middle">{up}</text>']
        for power in range(x_powers[0], x_powers[1] + 1):
            self.parts.append(f'<text x="{self.x(10.0**power):.1f}" y="{self.bottom + 18}" text-anchor="middle">10^{power}</text>')
        for power in range(y_powers[0], y_powers[1] + 1):
            y = self.y(10.0**power)
            self.parts.append(f'<path d="M{self.left} {y:.1f}H{self.right}" stroke="#ddd"/>'
                              f'<text x="{self.left - 8}" y="{y + 4:.1f}" text-anchor="end">{10.0**power:g}</text>')

    def x(self, value):
        low, high = self.x_powers
        return self.left + (math.log10(value) - low) / (high - low) * (self.right - self.left)

    def y(self, value):
        low, high = self.y_powers
        return self.bottom - (math.log10(value) - low) / (high - low) * (self.bottom - self.top)

    def line(self, name, points, colour=None, dashed=False):
        """Draws points (x, y); values of zero or below cannot be drawn on log axes and are skipped."""
        colour = colour or COLOURS[self.lines % len(COLOURS)]
        dash = ' stroke-dasharray="5 4"' if dashed else ""
        positions = [f"{self.x(x):.1f} {self.y(y):.1f}" for x, y in points if x > 0 and y > 0]
        self.parts.append(f'<path d="M{"L".join(positions)}" fill="none" stroke="{colour}" stroke-width="2"{dash}/>')
        self.parts += [f'<circle cx="{at.split()[0]}" cy="{at.split()[1]}" r="2.5" fill="{colour}"/>' for at in positions]
        at = self.top + 8 + 18 * self.lines
        self.parts.append(f'<path d="M{self.right + 12} {at}h26" stroke="{colour}" stroke-width="2"{dash}/>'
                          f'<text x="{self.right + 43}" y="{at + 4}">{name}</text>')
        self.lines += 1

    def group(self, across=0):
        return f'<g transform="translate({across} 0)">' + "\n".join(self.parts) + "</g>"


def page(plots):
    """One SVG with the plots side by side."""
    width, height = sum(plot.width for plot in plots), max(plot.height for plot in plots)
    at, groups = 0, []
    for plot in plots:
        groups.append(plot.group(at))
        at += plot.width
    return "\n".join([f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" font-family="sans-serif" font-size="12">',
                      '<rect width="100%" height="100%" fill="#fff"/>', *groups, "</svg>", ""])
