defmodule Aerie.Fleet.Missions.Separation do
  @moduledoc """
  How near vehicles come to each other on their courses (`Aerie.Fleet.Missions.Course`), and when. Pure, and exact:
  between two events of a pair both fly straight and evenly, so their distance has one least place there.
  """

  alias Aerie.Fleet.Missions.Course

  # Pairs of legs: some seconds. 60 vehicles of 200 items are 0.7 million, and took 1.3 s on a busy machine.
  @most_work 2_000_000

  @typedoc """
  `:at_s` after the first one starts; `:place` of the first of both on the map; `:heights?` false: only the map counts,
  because a height is not known.
  """
  @type pair :: %{
          one: String.t(),
          other: String.t(),
          metres: float(),
          at_s: float(),
          place: {float(), float()},
          heights?: boolean()
        }

  @doc """
  The nearest pass of each pair that is in the air at one time, the nearest first. Each course with its start in
  seconds; one that waits is in the air if its vehicle is (`waits?`).
  """
  @spec pairs([{Course.t(), start_s :: number(), waits? :: boolean()}]) ::
          {:ok, [pair()]} | {:error, String.t()}
  def pairs(courses) do
    legs = for {course, start, waits?} <- courses, do: {course, legs(course, start / 1, waits?)}
    count = legs |> Enum.map(fn {_course, legs} -> length(legs) end) |> Enum.sum()

    if count * max(length(legs) - 1, 0) > @most_work,
      do: {:error, "the plans are too many and too long to be compared"},
      else: {:ok, legs |> all() |> Enum.sort_by(& &1.metres)}
  end

  defp all([]), do: []

  defp all([{one, legs} | rest]) do
    found =
      for {other, others} <- rest,
          high = if(one.heights? and other.heights?, do: 1.0, else: 0.0),
          {square, at, place} <- [nearest(legs, others, high, nil)] do
        %{
          one: one.id,
          other: other.id,
          metres: :math.sqrt(square),
          at_s: at,
          place: place,
          heights?: high == 1.0
        }
      end

    found ++ all(rest)
  end

  # {from, until, place at from, speed}; `:infinity` is above all numbers.
  defp legs(%{points: []}, _start, _waits?), do: []

  defp legs(%{points: [{_t, x, y, z} | _] = points, until: until}, start, waits?) do
    before = if waits? and start > 0, do: [still(0.0, start, {x, y, z})], else: []

    moving =
      for {from, to} <- Enum.zip(points, tl(points)), elem(to, 0) > elem(from, 0), do: moving(from, to, start)

    {t, x, y, z} = List.last(points)
    before ++ moving ++ if(until == :stays, do: [still(start + t, :infinity, {x, y, z})], else: [])
  end

  defp still(from, until, place), do: {from, until, place, {0.0, 0.0, 0.0}}

  defp moving({t1, x1, y1, z1}, {t2, x2, y2, z2}, start) do
    t = t2 - t1
    {start + t1, start + t2, {x1, y1, z1}, {(x2 - x1) / t, (y2 - y1) / t, (z2 - z1) / t}}
  end

  # Both lists at once, each leg of the one with those of the other at the same time.
  defp nearest([{a1, a2, _, _} = a | rest_a] = as, [{b1, b2, _, _} = b | rest_b] = bs, high, least) do
    from = max(a1, b1)
    until = min(a2, b2)
    least = if from <= until, do: pass(a, b, from, until, high, least), else: least

    if a2 <= b2 and a2 != :infinity,
      do: nearest(rest_a, bs, high, least),
      else: further(as, b2, rest_b, high, least)
  end

  defp nearest(_as, _bs, _high, least), do: least

  # Both stay for ever.
  defp further(_as, :infinity, _rest_b, _high, least), do: least
  defp further(as, _b2, rest_b, high, least), do: nearest(as, rest_b, high, least)

  defp pass(
         {a1, _, {ax, ay, az}, {avx, avy, avz}},
         {b1, _, {bx, by, bz}, {bvx, bvy, bvz}},
         from,
         until,
         high,
         least
       ) do
    ta = from - a1
    tb = from - b1
    px = ax + ta * avx
    py = ay + ta * avy
    dx = px - (bx + tb * bvx)
    dy = py - (by + tb * bvy)
    dz = high * (az + ta * avz - (bz + tb * bvz))
    vx = avx - bvx
    vy = avy - bvy
    vz = high * (avz - bvz)
    speed = vx * vx + vy * vy + vz * vz
    t = if speed == 0.0, do: 0.0, else: -(dx * vx + dy * vy + dz * vz) / speed
    t = if t > 0.0, do: if(until == :infinity, do: t, else: min(t, until - from)), else: 0.0
    x = dx + t * vx
    y = dy + t * vy
    z = dz + t * vz
    square = x * x + y * y + z * z

    case least do
      {known, _at, _place} when known <= square -> least
      _farther -> {square, from + t, {px + t * avx, py + t * avy}}
    end
  end
end
