defmodule Aerie.Control.Policy.FlightPath do
  @moduledoc """
  Where a command brings its vehicle, as positions with their heights above home and above mean sea level: what the rules
  for heights and fences judge.
  """

  alias Aerie.Control.Policy.{Fence, Intent}
  alias Aerie.Control.Policy.Intent.Context
  alias Aerie.Control.Policy.FlightPath.Drift
  alias Aerie.Base.Geo.Earth
  alias Aerie.Vehicle.Command.Refusal
  alias Aerie.Vehicle.Firmware.Room

  @corners 36

  @typedoc """
  `{from, to}` is a straight way; `from` nil: only the place counts. `given`: what its height was given above, or `:same`.
  """
  @type leg :: {Fence.position() | nil, Fence.position(), given :: :home | :msl | :terrain | :same}

  @doc """
  The ways and places of a command with each of their heights above home: above the vehicle's home, and above where it took off if its home
  has been moved since.
  """
  @spec judged(Intent.t(), Context.t()) :: {:ok, [[leg()]]} | {:unknown, String.t()}
  def judged(facts, context) do
    with {:ok, legs} <- legs(facts, context) do
      above = fn
        nil, _datum -> nil
        position, datum -> %{position | home: minus(position.msl, datum) || position.home}
      end

      {:ok,
       [
         legs
         | for(
             datum <- context.datums,
             do: for({from, to, given} <- legs, do: {above.(from, datum), above.(to, datum), given})
           )
       ]}
    end
  end

  @doc "The ways and places of a command, or what of the vehicle is not known and would have to be."
  @spec legs(Intent.t(), Context.t()) :: {:ok, [leg()]} | {:unknown, String.t()}
  def legs(%{path: :none}, _context), do: {:ok, []}
  def legs(%{path: {:level, _height}}, _context), do: {:ok, []}
  def legs(%{path: :anywhere}, _context), do: {:unknown, Refusal.text(:anywhere)}
  def legs(%{path: {:unknown, why}}, _context), do: {:unknown, why}
  def legs(%{path: {:all, paths}} = facts, context), do: all(paths, &legs(%{facts | path: &1}, context))

  def legs(%{path: {:at, places}}, context) do
    with {:ok, positions} <- positions(places, context),
         do: {:ok, for({position, given} <- positions, do: {nil, position, given})}
  end

  def legs(%{path: {:along, places}}, context) do
    with {:ok, [{first, given} | _] = positions} <- positions(places, context),
         do: {:ok, [{nil, first, given} | ways(positions)]}
  end

  def legs(%{path: {:from, start, place}}, context) do
    with {:ok, [{from, _given}, {to, given}]} <- positions([start, place], context),
         do: {:ok, [{from, to, given}]}
  end

  def legs(%{path: {:to, places}}, context) do
    with {:ok, here} <- here(context),
         {:ok, positions} <- positions(places, context),
         do: {:ok, ways([{here, :same} | positions])}
  end

  def legs(%{path: {:ring, place, metres}}, context) do
    with {:ok, [{middle, given}]} <- positions([place], context) do
      [start | more] = for corner <- circle(middle, metres, middle), do: {corner, given}
      {:ok, [{nil, elem(start, 0), given} | ways([start | more])]}
    end
  end

  def legs(%{path: {:around, place, metres}}, context) do
    with {:ok, here} <- here(context),
         {:ok, [{middle, given}]} <- positions([place], context) do
      circle = circle(middle, metres, here)
      {:ok, ways(for position <- [here | circle], do: {position, given})}
    end
  end

  def legs(%{path: {:offset, {north, east, down}}}, context) do
    with {:ok, here} <- here(context),
         {:ok, origins} <- origins(context) do
      {:ok,
       for origin <- origins do
         from = %{
           lat: if(north, do: origin.lat, else: here.lat),
           lon: if(east, do: origin.lon, else: here.lon)
         }

         height = if down, do: below(origin, down, context), else: Map.take(here, [:home, :msl])
         {here, Map.merge(moved(from, north || 0, east || 0), height), if(down, do: :home, else: :same)}
       end}
    end
  end

  def legs(%{path: {:drift, drift}}, context) do
    with {:ok, here} <- here(context), do: drift(here, drift, context)
  end

  def legs(%{path: {:onward, path, drift}} = facts, context) do
    with {:ok, legs} <- legs(%{facts | path: path}, context),
         {_from, to, _given} = List.last(legs),
         {:ok, more} <- drift(to, drift, context),
         do: {:ok, legs ++ more}
  end

  def legs(%{path: {:shift, frame, {x, y, down}}}, context) do
    with {:ok, here} <- here(context),
         {:ok, {north, east}} <- turned(frame, x, y, context) do
      {:ok, [{here, shifted(here, {north, east, down}), :same}]}
    end
  end

  @doc """
  The heights that a command asks for, and to which the vehicle may climb because of it. Unlike `legs/2` it needs the
  vehicle's position only where a height depends on it.
  """
  @spec heights(Intent.t(), Context.t()) ::
          {:ok, [{home :: number() | nil, msl :: number() | nil, :home | :msl | :terrain | :own}]}
          | {:unknown, String.t()}
  def heights(%{sweep: {:land, _abort}} = facts, context) do
    with {:ok, heights} <- heights(%{facts | sweep: nil}, context) do
      %{climb: climb} = Room.around(facts.sweep, %{long: nil, rise: nil}, context)
      {:ok, heights ++ for({home, msl, given} <- heights, do: {plus(climb, home), plus(climb, msl), given})}
    end
  end

  def heights(%{path: {kind, places}}, context) when kind in [:to, :along, :at],
    do: {:ok, for(%{height: {above, _} = height} <- places, do: level(height, above, context))}

  def heights(%{path: {:from, _start, %{height: {above, _} = height}}}, context),
    do: {:ok, [level(height, above, context)]}

  def heights(%{path: {kind, %{height: {above, _} = height}, _metres}}, context)
      when kind in [:around, :ring],
      do: {:ok, [level(height, above, context)]}

  def heights(%{path: {:offset, {_north, _east, nil}}}, _context), do: {:ok, []}

  def heights(%{path: {:offset, {_north, _east, down}}}, context) do
    with {:ok, origins} <- origins(context) do
      {:ok,
       for origin <- origins do
         %{home: home, msl: msl} = below(origin, down, context)
         {home, msl, :home}
       end}
    else
      # On the ground where it started both are the same.
      {:unknown, _home} -> {:ok, [level({:home, -down}, :home, context)]}
    end
  end

  def heights(%{path: {:level, {above, _} = height}}, context), do: {:ok, [level(height, above, context)]}
  def heights(%{path: :anywhere}, _context), do: {:unknown, Refusal.text(:anywhere)}
  def heights(%{path: {:unknown, why}}, _context), do: {:unknown, why}
  def heights(%{path: {:all, paths}} = facts, context), do: all(paths, &heights(%{facts | path: &1}, context))

  def heights(%{path: {:shift, _frame, {_x, _y, down}}}, _context) when down == 0, do: {:ok, []}
  def heights(%{path: {:drift, drift}}, _context) when drift.vertical? == false, do: {:ok, []}

  def heights(%{path: {:onward, path, %{vertical?: false}}} = facts, context),
    do: heights(%{facts | path: path}, context)

  def heights(%{path: path} = facts, context) when elem(path, 0) in [:shift, :drift, :onward] do
    with {:ok, legs} <- legs(facts, context),
         do: {:ok, for({_from, to, _given} <- legs, uniq: true, do: {to.home, to.msl, :own})}
  end

  def heights(_level, _context), do: {:ok, []}

  @doc "The room that the vehicle takes at the end of a leg."
  @spec room(leg(), Intent.sweep(), Context.t()) :: Room.t()
  def room({from, to, _given}, sweep, context) do
    long = from && Earth.distance(Earth.point(from.lat, from.lon), Earth.point(to.lat, to.lon))
    Room.around(sweep, %{long: long, rise: to.home}, context)
  end

  @doc "A position so many metres higher."
  @spec raised(Fence.position(), number()) :: Fence.position()
  def raised(position, metres),
    do: %{position | home: plus(metres, position.home), msl: plus(metres, position.msl)}

  defp all(paths, fun) do
    Enum.reduce_while(paths, {:ok, []}, fn path, {:ok, done} ->
      case fun.(path) do
        {:ok, found} -> {:cont, {:ok, done ++ found}}
        unknown -> {:halt, unknown}
      end
    end)
  end

  defp level(height, above, context) do
    %{home: home, msl: msl} = heights(height, nil, context)
    {home, msl, above}
  end

  defp ways(positions) do
    Enum.zip_with(positions, tl(positions), fn {from, _given}, {to, given} -> {from, to, given} end)
  end

  defp positions(places, context) do
    Enum.reduce_while(places, {:ok, []}, fn place, {:ok, done} ->
      case position(place, context) do
        {:ok, position} -> {:cont, {:ok, [position | done]}}
        unknown -> {:halt, unknown}
      end
    end)
    |> then(fn result -> with {:ok, done} <- result, do: {:ok, Enum.reverse(done)} end)
  end

  defp position(%{lat: lat, lon: lon}, _context)
       when is_number(lat) and is_number(lon) and (abs(lat) > 90 or abs(lon) > 180),
       do: {:unknown, Refusal.text(:nowhere, lat: lat, lon: lon)}

  defp position(%{lat: lat, lon: lon, height: height}, context) when is_number(lat) and is_number(lon) do
    here = with {:ok, here} <- here(context), do: here, else: (_unknown -> %{home: nil, msl: nil})
    {:ok, {Map.merge(%{lat: lat, lon: lon}, heights(height, here, context)), given(height)}}
  end

  defp position(%{lat: lat, lon: lon, height: height}, context) do
    with {:ok, here} <- here(context) do
      there = %{here | lat: lat || here.lat, lon: lon || here.lon}
      {:ok, {Map.merge(there, heights(height, here, context)), given(height)}}
    end
  end

  defp given(:same), do: :same
  defp given({above, _metres}), do: above

  defp heights(:same, here, _context), do: Map.take(here, [:home, :msl])
  defp heights({:home, metres}, _here, context), do: %{home: metres, msl: plus(metres, home_msl(context))}
  defp heights({:msl, metres}, _here, context), do: %{home: minus(metres, home_msl(context)), msl: metres}
  # How high the ground is there, nobody here knows.
  defp heights({:terrain, _metres}, _here, _context), do: %{home: nil, msl: nil}

  defp home_msl(%{home: nil}), do: nil
  defp home_msl(%{home: home}), do: home.alt_msl

  defp plus(a, b), do: b && a + b
  defp minus(a, b), do: a && b && a - b

  defp here(context) do
    with {:ok, position} <- Context.position(context),
         do: {:ok, %{lat: position.lat, lon: position.lon, home: position.alt_rel, msl: position.alt_msl}}
  end

  defp turned(:north, north, east, _context), do: {:ok, {north, east}}

  defp turned(:body, _ahead, _right, %{position: %{heading: nil}}),
    do: {:unknown, Refusal.text(:heading)}

  defp turned(:body, ahead, right, %{position: %{heading: heading}}) do
    {north, east, _down} = Drift.turned({ahead, right, 0}, heading * :math.pi() / 180)
    {:ok, {north, east}}
  end

  # From a place, along each direction that the drift may take.
  defp drift(start, drift, context) do
    with {:ok, ways} <- Drift.ways(drift, context) do
      {:ok,
       for(way <- ways, leg <- ways([{start, :same} | Enum.map(way, &{shifted(start, &1), :same})]), do: leg)}
    end
  end

  defp shifted(from, {north, east, down}) do
    climb = fn height -> height && height - down end
    %{moved(from, north, east) | home: climb.(from.home), msl: climb.(from.msl)}
  end

  # Local coordinates begin where the vehicle was when it first knew its place, which is not its home any more when that was moved.
  defp origins(%{home: nil, origin: nil}), do: {:unknown, Refusal.text(:home)}

  defp origins(%{home: home, origin: origin}),
    do: {:ok, [origin, home] |> Enum.reject(&is_nil/1) |> Enum.uniq()}

  defp below(origin, down, context) do
    msl = minus(origin.alt_msl, down)
    %{home: minus(msl, home_msl(context)) || -down, msl: msl}
  end

  # Degrees from metres, for the short distances that set-points are about.
  defp moved(from, north, east) do
    radius = 6_378_137.0
    lat = from.lat + north / radius * 180 / :math.pi()
    lon = from.lon + east / (radius * max(:math.cos(from.lat * :math.pi() / 180), 1.0e-6)) * 180 / :math.pi()
    %{lat: lat |> max(-90.0) |> min(90.0), lon: lon, home: nil, msl: nil}
  end

  # Straight pieces around the circle, so far out that no part of it lies beyond them, from the corner that is nearest.
  defp circle(middle, metres, here) do
    centre = Earth.point(middle.lat, middle.lon)
    reach = max(abs(metres), 0.1) / :math.cos(:math.pi() / @corners)

    corners =
      for n <- 0..(@corners - 1) do
        {lat, lon} = centre |> Earth.destination(n * 360 / @corners, reach) |> Earth.degrees()
        %{middle | lat: lat, lon: lon}
      end

    start = Earth.point(here.lat, here.lon)
    nearest = fn n -> Earth.distance(start, Earth.point(Enum.at(corners, n).lat, Enum.at(corners, n).lon)) end
    {before, from} = Enum.split(corners, Enum.min_by(0..(@corners - 1), nearest))
    from ++ before ++ [hd(from)]
  end
end
