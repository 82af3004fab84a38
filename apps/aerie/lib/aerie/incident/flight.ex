defmodule Aerie.Incident.Flight do
  @moduledoc """
  What a copied recording shows of a vehicle: its events as `aerie replay` prints them, values over time, modes, the
  track, and how it was heard. Everything comes from the replay's core (`Aerie.Fleet.Replay.Machine`), so the same
  recording gives the same flight.
  """

  alias Aerie.Base.Json
  alias Aerie.Fleet.Bridge.Message
  alias Aerie.Fleet.Replay.{Machine, Settings, Source}
  alias Aerie.Incident.{Series, Span}
  alias Aerie.Vehicle.{Event, Options}
  alias MavCodec.Frame

  @max_events 20_000
  @max_changes 500
  @track_points 1_500

  # Name, title, unit, group and field of a sample, factor.
  @values [
    {:altitude, "Altitude above home", "m", :position, :alt_rel, 1},
    {:altitude_msl, "Altitude above sea level", "m", :position, :alt_msl, 1},
    {:speed, "Ground speed", "m/s", :velocity, :groundspeed, 1},
    {:climb, "Climb rate", "m/s", :velocity, :climb, 1},
    {:voltage, "Battery voltage", "V", :battery, :voltage, 1},
    {:remaining, "Battery remaining", "%", :battery, :remaining, 100}
  ]
  @link [{:rate, "Frames heard", "1/s"}, {:loss, "Frames lost", "%"}]

  defstruct [
    :span,
    :vehicle,
    events: [],
    kept: 0,
    left_out: 0,
    series: %{},
    changes: %{mode: [], armed: []},
    track: [],
    heard: %{},
    sequence: %{},
    systems: %{},
    last: nil
  ]

  @typedoc """
  - `events`: `{event, line}` in order; `left_out`: those beyond #{@max_events}
  - `series`: points by name (`plots/0`); `changes`: `{at, value}` of `:mode` and `:armed`
  - `track`: `{latitude, longitude}` in order; `last`: the time of the last frame heard of the vehicle
  """
  @type t :: %__MODULE__{
          span: Span.t(),
          vehicle: String.t(),
          events: [{Event.t(), String.t()}],
          left_out: non_neg_integer(),
          series: %{atom() => term()},
          changes: %{mode: [{integer(), term()}], armed: [{integer(), term()}]},
          track: [term()],
          last: integer() | nil
        }

  @doc "Names, titles and units of the plots, in their order."
  @spec plots() :: [{atom(), String.t(), String.t()}]
  def plots,
    do: for({name, title, unit, _group, _field, _factor} <- @values, do: {name, title, unit}) ++ @link

  @doc "A flight of which nothing was recorded."
  @spec none(String.t(), Span.t()) :: t()
  def none(vehicle, span), do: %__MODULE__{vehicle: vehicle, span: span}

  @doc "Reads a recording. The error names the file."
  @spec read(Path.t(), network :: String.t(), Settings.t(), String.t(), Span.t()) ::
          {:ok, t()} | {:error, String.t()}
  def read(path, network, settings, vehicle, span) do
    machine = Machine.new(settings, network: network)
    id = &Options.id(settings.vehicle, {network, &1})

    step = fn item, {machine, flight} ->
      {machine, outputs} = Machine.push(machine, item)
      {machine, outputs |> Enum.reduce(hear(flight, item, id), &output/2)}
    end

    with {:ok, {machine, flight}} <-
           Source.reduce(path, Machine.parser(settings), {machine, start(vehicle, span)}, step) do
      {_machine, outputs} = Machine.finish(machine)
      {:ok, outputs |> Enum.reduce(flight, &output/2) |> finish()}
    end
  end

  defp start(vehicle, span) do
    series = for {name, _title, _unit} <- plots(), into: %{}, do: {name, Series.new(span)}
    %__MODULE__{vehicle: vehicle, span: span, series: series}
  end

  # How it was heard: frames a second, and gaps in their numbers.
  defp hear(flight, %Frame{crc_extra: extra, system: system} = frame, id) when extra != nil do
    flight = %{flight | systems: Map.put_new_lazy(flight.systems, system, fn -> id.(system) end)}

    if flight.systems[system] == flight.vehicle do
      source = {system, frame.component}
      gap = Integer.mod(frame.seq - Map.get(flight.sequence, source, frame.seq - 1) - 1, 256)
      # A copy by another link, or one that was overtaken, looks like a large gap.
      lost = if gap < 128, do: gap, else: 0
      interval = div(frame.at - flight.span.from, interval(flight.span))
      heard = Map.update(flight.heard, interval, {1, lost}, fn {n, gone} -> {n + 1, gone + lost} end)
      sequence = Map.put(flight.sequence, source, frame.seq)
      %{flight | heard: heard, sequence: sequence, last: max(flight.last || 0, frame.at)}
    else
      flight
    end
  end

  defp hear(flight, _other, _id), do: flight

  defp interval(span), do: max(div(span.to - span.from, 300), 1_000_000)

  defp output({:event, %{vehicle: vehicle} = event}, %{vehicle: vehicle} = flight) do
    if flight.kept < @max_events do
      line = Json.line(Message.event(event))
      %{flight | events: [{event, line} | flight.events], kept: flight.kept + 1}
    else
      %{flight | left_out: flight.left_out + 1}
    end
  end

  defp output({:sample, %{vehicle: vehicle} = sample}, %{vehicle: vehicle} = flight) do
    sample = complete(sample)

    @values
    |> Enum.reduce(flight.series, &value(&1, &2, sample))
    |> then(&%{flight | series: &1})
    |> change(sample)
    |> track(sample)
  end

  defp output(_other, flight), do: flight

  # Not every vehicle sends VFR_HUD.
  defp complete(%{group: :velocity, data: %{groundspeed: nil, vn: north, ve: east} = data} = sample)
       when is_number(north) and is_number(east) do
    climb = if is_number(data[:vd]), do: -data.vd
    speed = :math.sqrt(north * north + east * east)
    %{sample | data: %{data | groundspeed: speed} |> Map.update(:climb, climb, &(&1 || climb))}
  end

  defp complete(sample), do: sample

  defp value({name, _title, _unit, group, field, factor}, series, %{group: group, at: at, data: data}) do
    case data do
      %{^field => value} when is_number(value) ->
        Map.update!(series, name, &Series.push(&1, at, value * factor))

      _none ->
        series
    end
  end

  defp value(_value, series, _sample), do: series

  defp change(flight, %{group: :mode, at: at, data: data}) do
    changes =
      for name <- [:mode, :armed], into: %{}, do: {name, changed(flight.changes[name], at, data[name])}

    %{flight | changes: changes}
  end

  defp change(flight, _sample), do: flight

  defp changed([{_at, value} | _older] = changes, _now, value), do: changes
  defp changed(changes, at, value) when length(changes) < @max_changes, do: [{at, value} | changes]
  # From here on it is not known.
  defp changed(changes, at, _value) when length(changes) == @max_changes, do: [{at, nil} | changes]
  defp changed(changes, _at, _value), do: changes

  # One place for each interval of the span.
  defp track(flight, %{group: :position, at: at, data: %{lat: lat, lon: lon}})
       when is_number(lat) and is_number(lon) do
    interval = div((at - flight.span.from) * @track_points, flight.span.to - flight.span.from)

    case flight.track do
      [{^interval, _place} | _older] -> flight
      track -> %{flight | track: [{interval, {lat, lon}} | track]}
    end
  end

  defp track(flight, _sample), do: flight

  defp finish(flight) do
    flight = %{flight | series: Map.merge(flight.series, link(flight))}
    series = for {name, series} <- flight.series, into: %{}, do: {name, Series.points(series)}
    # The height above sea level only stands in for the other one.
    series = if series.altitude == [], do: series, else: %{series | altitude_msl: []}

    %{
      flight
      | series: series,
        events: Enum.reverse(flight.events),
        changes: Map.new(flight.changes, fn {name, changes} -> {name, Enum.reverse(changes)} end),
        track: for({_interval, place} <- Enum.reverse(flight.track), do: place)
    }
  end

  defp link(%{heard: heard} = flight) when heard == %{}, do: Map.take(flight.series, [:rate, :loss])

  # An interval in which nothing was heard counts as well.
  defp link(%{heard: heard, span: span} = flight) do
    width = interval(span)
    {first, last} = heard |> Map.keys() |> Enum.min_max()
    until = max(last, div(span.to - span.from, width) - 1)

    Enum.reduce(first..until, Map.take(flight.series, [:rate, :loss]), fn interval, series ->
      at = span.from + interval * width
      {frames, lost} = Map.get(heard, interval, {0, 0})
      rate = Series.push(series.rate, at, frames * 1_000_000 / width)
      loss = if frames == 0, do: series.loss, else: Series.push(series.loss, at, 100 * lost / (frames + lost))
      %{rate: rate, loss: loss}
    end)
  end
end
