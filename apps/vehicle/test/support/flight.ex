defmodule Aerie.Flight do
  @moduledoc """
  Recorded flights for tests, and what the pure core and detector make of them.
  """

  alias Aerie.Vehicle.Options
  alias Aerie.Vehicle.Events.Detector
  alias Aerie.Vehicle.Session.Core
  alias MavCodec.{Frame, Parser, Tlog}

  @fixtures Path.expand("../fixtures", __DIR__)

  @doc "The frames of a gzipped tlog of the fixtures, in order, with their times."
  @spec frames(String.t()) :: [Frame.t()]
  def frames(name),
    do: @fixtures |> Path.join(name <> ".tlog.gz") |> File.read!() |> :zlib.gunzip() |> parse()

  @doc "The frames of a tlog."
  @spec parse(binary()) :: [Frame.t()]
  def parse(tlog) do
    {frames, decoder} = Tlog.Decoder.push(Tlog.Decoder.new(), tlog)
    Enum.filter(frames ++ Tlog.Decoder.finish(decoder), &is_struct(&1, Frame))
  end

  @doc "A frame of a message that comes `at` (us). Options: `:system`, `:component`, `:seq`, `:version`."
  @spec frame(struct(), integer(), keyword()) :: Frame.t()
  def frame(message, at, options \\ []) do
    bytes = MavCodec.encode(message, Keyword.merge([system: 1, component: 1], options))
    {[frame], _parser} = Parser.push(Parser.new(), bytes, at)
    frame
  end

  @doc "Options of a vehicle for tests."
  @spec options(keyword()) :: Options.t()
  def options(extra \\ []),
    do: Options.new(Aerie.Vehicle.Settings.from(%{}), {"main", Keyword.get(extra, :system_id, 1)}, extra)

  @doc """
  Everything that core and detector make of frames: `%{events: …, actions: …, core: …, detector: …}`. `:batch` is how many
  frames come at once, 7 when absent.
  """
  @spec run([Frame.t()], keyword()) :: map()
  def run(frames, extra \\ []) do
    {batch, extra} = Keyword.pop(extra, :batch, 7)
    options = options(extra)
    start = %{core: Core.new(options), detector: Detector.new(options), events: [], actions: [], params: %{}}

    frames
    |> Enum.chunk_every(batch)
    |> Enum.reduce(start, &step(&2, {:frames, "link", &1}))
    |> then(&%{&1 | events: Enum.reverse(&1.events), actions: Enum.reverse(&1.actions)})
  end

  @doc "One step of a run; its events and actions are in reverse order while it goes on."
  @spec step(map(), Core.event()) :: map()
  def step(run, event) do
    {core, actions} = Core.handle(run.core, event)

    Enum.reduce(actions, %{run | core: core, actions: Enum.reverse(actions) ++ run.actions}, fn
      {:observe, observation}, run ->
        {detector, events, params} = Detector.observe(run.detector, observation, &Map.fetch(run.params, &1))

        %{
          run
          | detector: detector,
            events: Enum.reverse(events) ++ run.events,
            params: Map.merge(run.params, params)
        }

      _other, run ->
        run
    end)
  end

  @doc "The events of some types, as `{type, time in ms, data}`."
  @spec pick(map() | [Aerie.Vehicle.Event.t()], [String.t()]) :: [{String.t(), integer(), map()}]
  def pick(%{events: events}, types), do: pick(events, types)

  def pick(events, types) when is_list(events) do
    for event <- events, event.type in types, do: {event.type, div(event.time, 1000), event.data}
  end
end
