defmodule Aerie.Vehicle.Firmware.Page do
  @moduledoc "The table of gaps in `docs/commands.md`: which commands a firmware lacks, and why."

  alias Aerie.Vehicle.Command.{Page, Types}
  alias Aerie.Vehicle.Firmware

  @kinds ~w(copter plane vtol rover boat sub)

  @doc "The section by its name."
  @spec sections() :: %{String.t() => String.t()}
  def sections, do: %{"gaps" => Page.table(["command", "firmware", "kinds", "why not"], rows())}

  @doc "The kinds of vehicles in the table."
  @spec kinds() :: [String.t()]
  def kinds, do: @kinds

  defp rows do
    for name <- Types.names(),
        {reason, firmwares, kinds} <- by_reason(name),
        do: ["`#{name}`", firmwares, if(kinds == @kinds, do: "all", else: Enum.join(kinds, ", ")), reason]
  end

  # Firmwares that lack it on the same kinds for the same reason have one row.
  defp by_reason(name) do
    gaps =
      for firmware <- Firmware.names(),
          {reason, kinds} <- kinds(name, firmware),
          do: {{reason, kinds}, Firmware.title(firmware)}

    for {reason, kinds} = gap <- gaps |> Enum.map(&elem(&1, 0)) |> Enum.uniq(),
        do: {reason, Enum.join(for({^gap, firmware} <- gaps, do: firmware), ", "), kinds}
  end

  defp kinds(name, firmware) do
    gaps = for kind <- @kinds, reason = Firmware.of(firmware).gap(name, kind), do: {reason, kind}

    for reason <- gaps |> Enum.map(&elem(&1, 0)) |> Enum.uniq(),
        do: {reason, for({^reason, kind} <- gaps, do: kind)}
  end
end
