defmodule Aerie.Vehicle.Protocol.Page do
  @moduledoc "The table of gaps in `docs/commands.md`: which commands a firmware lacks, and why."

  alias Aerie.Vehicle.Command.{Page, Types}
  alias Aerie.Vehicle.Protocol

  @firmwares [{"ArduPilot", Protocol.Ardupilot}, {"PX4", Protocol.Px4}, {"Betaflight, iNav", Protocol.Msp}]
  @kinds ~w(copter plane vtol rover boat sub)

  @doc "The section by its name."
  @spec sections() :: %{String.t() => String.t()}
  def sections, do: %{"gaps" => Page.table(["command", "firmware", "kinds", "why not"], rows())}

  @doc "The kinds of vehicles in the table."
  @spec kinds() :: [String.t()]
  def kinds, do: @kinds

  defp rows do
    for name <- Types.names(),
        {firmware, protocol} <- @firmwares,
        {reason, kinds} <- by_reason(protocol, name),
        do: ["`#{name}`", firmware, if(kinds == @kinds, do: "all", else: Enum.join(kinds, ", ")), reason]
  end

  defp by_reason(protocol, name) do
    gaps = for kind <- @kinds, reason = protocol.gap(name, kind), do: {reason, kind}

    for reason <- gaps |> Enum.map(&elem(&1, 0)) |> Enum.uniq(),
        do: {reason, for({^reason, kind} <- gaps, do: kind)}
  end
end
