defmodule Aerie.CommandSamples do
  @moduledoc "Commands for tests: one of each type, and any."

  alias Aerie.Vehicle.Command
  alias Aerie.Vehicle.Command.{Type, Types}
  alias Aerie.Vehicle.Protocol.Vehicle

  @now 1_795_000_000_000_000

  @doc "A command of a type; for a type with rules the parameters have to be given."
  @spec command(String.t(), map(), keyword()) :: Command.t()
  def command(name, params \\ %{}, more \\ []) do
    {:ok, command} = Command.new([vehicle: "V", type: name, params: params] ++ more, @now)
    command
  end

  @doc "The time at which the samples are issued."
  @spec now() :: integer()
  def now, do: @now

  @doc "A copter in the air of which everything is known."
  @spec vehicle(:ardupilot | :px4, map()) :: Vehicle.t()
  def vehicle(autopilot, more \\ %{}) do
    struct!(
      %Vehicle{
        system: 1,
        autopilot: autopilot,
        kind: "copter",
        mode: if(autopilot == :px4, do: "AUTO_LOITER", else: "GUIDED"),
        armed: true,
        in_air: true,
        lat: 47.397742,
        lon: 8.545594,
        alt_msl: 509.566,
        alt_rel: 20.0,
        heading: 90.0,
        home: %{lat: 47.397742, lon: 8.545594, alt_msl: 489.566}
      },
      more
    )
  end

  @doc "A generator of commands of all types, with any parameters that are allowed."
  @spec any() :: term()
  def any do
    let(:proper_types.oneof(Types.all()), fn type ->
      values = Enum.map(type.params, &{&1.name, {:proper_types.boolean(), value(&1)}})

      let(values, fn values -> command(type.name, params(type, Map.new(values))) end)
    end)
  end

  # Of a rule about several, those that come first are kept.
  defp params(type, values) do
    given =
      for param <- type.params,
          {given?, value} = values[param.name],
          given? or param.required,
          do: {param.name, value}

    given = Enum.reduce(type.rules, Map.new(given), &keep(&1, &2, values))
    {:ok, _checked} = Type.check(type, Map.new(given, fn {name, value} -> {"#{name}", value} end))
    given
  end

  defp keep({:together, names}, given, values) do
    if Enum.any?(names, &is_map_key(given, &1)),
      do: Enum.reduce(names, given, &put(&1, &2, values)),
      else: given
  end

  defp keep({:one_of, names}, given, values) do
    chosen = Enum.find(names, hd(names), &is_map_key(given, &1))
    # `here` in place of a place.
    others = if :lat in names and chosen != :lat, do: [:lon, :altitude_msl], else: []
    given |> Map.drop(names ++ others) |> then(&put(chosen, &1, values))
  end

  defp put(name, given, values), do: Map.put(given, name, values |> Map.fetch!(name) |> elem(1))

  defp value(%{type: :number} = p), do: :proper_types.float(p.min * 1.0, p.max * 1.0)
  defp value(%{type: :integer} = p), do: :proper_types.integer(p.min, p.max)
  defp value(%{type: :boolean, values: [value]}), do: value
  defp value(%{type: :boolean}), do: :proper_types.boolean()
  defp value(%{type: :choice} = p), do: :proper_types.oneof(p.values)
  defp value(%{type: :text}), do: :proper_types.oneof(["GUIDED", "auto_loiter", "RTL", "no such mode"])
  defp value(%{type: :list} = p), do: :proper_types.vector(p.max, value(p.items))

  # :proper.let is a macro in Erlang: this is what it becomes.
  defp let(raw, fun), do: :proper_types.bind(raw, fun, false)
end
