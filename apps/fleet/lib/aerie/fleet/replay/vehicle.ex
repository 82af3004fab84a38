defmodule Aerie.Fleet.Replay.Vehicle do
  @moduledoc """
  One vehicle of a replay: `Aerie.Vehicle.Session` and `Aerie.Vehicle.Events` as a value. The core gets the same events as in a
  live gateway; its actions become outputs.
  """

  alias Aerie.Vehicle.Options
  alias Aerie.Vehicle.Events.Detector
  alias Aerie.Vehicle.Session.Core

  # As in the journal of a live gateway.
  @max_params 8_192

  @enforce_keys [:options, :core, :detector]
  defstruct [:options, :core, :detector, params: %{}]

  @type t :: %__MODULE__{
          options: Options.t(),
          core: Core.t(),
          detector: Detector.t(),
          params: %{String.t() => term}
        }

  @typedoc "See `t:Aerie.Fleet.Replay.output/0`."
  @type output :: Aerie.Fleet.Replay.output()

  @doc "A vehicle that is heard for the first time."
  @spec new(Options.t(), link :: String.t(), high_latency :: boolean) :: t
  def new(options, link, high_latency) do
    core = Core.new(options)
    {core, []} = Core.handle(core, {:demand, %{messages: %{}, groups: %{}}, nil})
    {core, []} = Core.handle(core, {:link, link, %{high_latency: high_latency}})
    %__MODULE__{options: options, core: core, detector: Detector.new(options)}
  end

  @doc "One step. Its outputs are prepended to `outputs`, newest first."
  @spec step(t, Core.event(), integer, [output]) :: {t, [output]}
  def step(vehicle, event, at, outputs) do
    {core, actions} = Core.handle(vehicle.core, event)
    Enum.reduce(actions, {%{vehicle | core: core}, outputs}, &act(&1, &2, at))
  end

  defp act({:observe, observation}, {vehicle, outputs}, _at) do
    {detector, events, learned} =
      Detector.observe(vehicle.detector, observation, &Map.fetch(vehicle.params, &1))

    params = Enum.reduce(learned, vehicle.params, &learn/2)
    {%{vehicle | detector: detector, params: params}, Enum.reduce(events, outputs, &[{:event, &1} | &2])}
  end

  defp act({:publish, group, %{data: data, time_boot_ms: boot_ms}, sampled}, {vehicle, outputs}, _at) do
    sample = %{vehicle: vehicle.options.id, group: group, at: sampled, time_boot_ms: boot_ms, data: data}
    {vehicle, [{:sample, sample} | outputs]}
  end

  defp act({:send, message, version}, {vehicle, outputs}, at) do
    {vehicle, [{:send, %{vehicle: vehicle.options.id, at: at, message: message, version: version}} | outputs]}
  end

  defp act({:send, message, version, _link}, acc, at), do: act({:send, message, version}, acc, at)

  defp act({:status, old, new}, {vehicle, outputs}, at) do
    {vehicle, [{:status, %{vehicle: vehicle.options.id, at: at, from: old, to: new}} | outputs]}
  end

  # Snapshots are read at the end; our heartbeats and counters only concern a live gateway.
  defp act(_other, acc, _at), do: acc

  defp learn({name, value}, params) do
    if is_map_key(params, name) or map_size(params) < @max_params,
      do: Map.put(params, name, value),
      else: params
  end
end
