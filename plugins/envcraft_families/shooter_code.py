"""Code of the generated shooting games: shots, hits, and how enemies come and move."""

from __future__ import annotations

ADVANCE = """
self.rest = max(0, self.rest - 1)
if first and self.rest == 0 and self.ammunition > 0:
    self.rest = REST
    self.ammunition -= 1
    self.bullets += [<<barrels>>]
    <<shot>>
self._fly()
self._bring()
passed = [enemy for enemy in self.enemies if enemy[1] + 5 >= FLOOR]
for enemy in passed:
    self.enemies.remove(enemy)
    self.lives -= 1
"""

FLY = '''
def _fly(self) -> None:
    """Move the bullets, and remove those that strike."""
    for bullet in self.bullets:
        bullet[1] -= BULLET_SPEED
    self.bullets = [bullet for bullet in self.bullets if bullet[1] > CEILING and not self._strikes(*bullet)]

def _strikes(self, x: int, y: int) -> bool:
    """Damage the enemy at a bullet, and return whether there is one."""
    for enemy in self.enemies:
        if enemy[0] - 1 <= x < enemy[0] + ENEMY and enemy[1] - 1 <= y <= enemy[1] + 5:
            enemy[2] -= DAMAGE
            <<struck>>
            if enemy[2] <= 0:
                self.enemies.remove(enemy)
                self.kills += 1
                self.won = self.kills >= WANTED
                <<killed>>
            return True
    return False
'''

BRING = '''
def _bring(self) -> None:
    """Let enemies come, and move them."""
    <<brought>>
'''

_TO_AND_FRO = """
for enemy in self.enemies:
    if not 0 <= enemy[0] + enemy[3] <= SIZE - ENEMY:
        enemy[3] = -enemy[3]
    enemy[0] += enemy[3]
"""

MOVES = {
    "march": (
        """
        if not self.enemies:
            left = int(self.np_random.integers(4, 30))
            self.enemies = [[left + 14 * (n % 4), CEILING + 2 + 9 * (n // 4), HITS, 1] for n in range(8)]
        if self.steps % 2 == 0:
            if any(not 0 <= enemy[0] + enemy[3] <= SIZE - ENEMY for enemy in self.enemies):
                for enemy in self.enemies:
                    enemy[1] += 4
                    enemy[3] = -enemy[3]
            else:
                for enemy in self.enemies:
                    enemy[0] += enemy[3]
        """,
    ),
    "rain": (
        """
        if self.steps % COME_EVERY == 1:
            self.enemies.append([int(self.np_random.integers(SIZE - ENEMY)), CEILING + 1, HITS, 0])
        if self.steps % 2 == 0:
            for enemy in self.enemies:
                enemy[1] += 1
        """,
    ),
    "weave": (
        """
        if self.steps % COME_EVERY == 1:
            side = 1 if self.np_random.random() < 0.5 else -1
            self.enemies.append([int(self.np_random.integers(SIZE - ENEMY)), CEILING + 1, HITS, side])
        for enemy in self.enemies:
            enemy[1] += self.steps % 3 == 0
        """,
        _TO_AND_FRO,
    ),
    "patrol": (
        """
        heights = {enemy[1] for enemy in self.enemies}
        for row in range(3):
            if CEILING + 2 + 12 * row not in heights:
                side = 1 if self.np_random.random() < 0.5 else -1
                start = int(self.np_random.integers(SIZE - ENEMY))
                self.enemies.append([start, CEILING + 2 + 12 * row, HITS, side])
        """,
        _TO_AND_FRO,
    ),
    "giant": (
        """
        if not self.enemies:
            side = 2 if self.np_random.random() < 0.5 else -2
            self.enemies = [[int(self.np_random.integers(SIZE - ENEMY)), CEILING + 8, HITS, side]]
        """,
        _TO_AND_FRO,
    ),
}

FIRE = '''
def _fire(self) -> None:
    """Let an enemy fire now and then, and move the shots."""
    if self.steps % FIRE_EVERY == 0 and self.enemies:
        enemy = self.enemies[int(self.np_random.integers(len(self.enemies)))]
        self.shots.append([enemy[0] + ENEMY // 2, enemy[1] + 5, <<course>>])
    for shot in self.shots:
        shot[0] += shot[2]
        shot[1] += SHOT_SPEED
    hits = [shot for shot in self.shots if self.ship - 1 <= shot[0] < self.ship + SHIP and shot[1] + 2 >= FLOOR]
    self.lives -= len(hits)
    flying = [shot for shot in self.shots if 0 <= shot[0] <= SIZE - 2 and shot[1] < FLOOR + 4]
    self.shots = [shot for shot in flying if shot not in hits]
'''

DRAW = """
frame = BACKDROP.copy()
for x, y, hits, side in self.enemies:
    frame[y : y + 5, x : x + ENEMY] = ENEMY_TILE
    # The light at the front shows the direction, and the line the hits that are left.
    frame[y + 2, x + (ENEMY - 1 if side > 0 else 0)] = PAGE
    frame[y + 4, x : x + max(1, ENEMY * hits // HITS)] = SHOT
for x, y in self.bullets:
    frame[y : y + 3, x : x + 2] = BULLET
for x, y, _ in self.shots:
    frame[y : y + 3, x : x + 2] = SHOT
frame[FLOOR : FLOOR + 5, self.ship : self.ship + SHIP] = SHIP_TILE
frame[FLOOR + 2, self.ship + SHIP // 2 + self.drift // 2] = PAGE
frame[81, 2 : 2 + 80 * self.ammunition // AMMUNITION] = BULLET
frame[1, 20 : 20 + 60 * self.kills // WANTED] = BAR
frame[3, 20 : 20 + 4 * self.rest] = BULLET
for number in range(self.lives):
    frame[1:4, 2 + 5 * number : 5 + 5 * number] = SHIP_COLOUR
<<draw_fire>>
"""
