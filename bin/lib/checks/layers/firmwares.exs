# Where code knows a firmware by its name. What is particular to one belongs into its folder in apps/vehicle's
# firmware/, so that a new firmware is a folder and a line in the list.
defmodule Layers.Firmwares do
  @names ~w(ardupilot px4 betaflight inav)
  # As a vehicle or a flight controller says it.
  @numbers %{MAV_AUTOPILOT_ARDUPILOTMEGA: 3, MAV_AUTOPILOT_PX4: 12}
  @said ~w(btfl)
  # Dialects of MAVLink have such names as well.
  @dialects [:MavCodec, :Dialects]

  @own "apps/vehicle/lib/aerie/vehicle/firmware"
  # What may name firmwares besides, and why.
  @elsewhere %{
    "apps/aerie/lib/aerie/cli/start/sim_msp.ex" => "which simulator is started",
    "apps/mav_codec/lib/mav_codec/definition/catalog.ex" => "a folder of MAVLink's definitions",
    "apps/mav_codec/lib/mav_codec/msp/" =>
      "the wire: both firmwares have messages and parameters of their own",
    "apps/mav_codec/lib/mav_codec/sniff/text.ex" => "what a port prints, before there is a vehicle",
    "apps/mav_router/lib/mav_router/link/serial/finding.ex" =>
      "what a port is called, before there is a vehicle",
    "apps/mav_router/lib/mav_router/link/serial/probe.ex" => "what a port answers, before there is a vehicle",
    "apps/mav_router/lib/mav_router/link/settings.ex" => "a dialect of MAVLink",
    "apps/msp/lib/msp/firmware.ex" => "the list of those that speak MSP",
    "apps/msp/lib/msp/firmware/" => "the tables of those that speak MSP",
    "apps/msp/lib/msp/readings/" => "the wire: which of its messages each is asked for, and how often"
  }

  @doc "The places that may name one, by their paths."
  def elsewhere, do: Map.keys(@elsewhere)

  @doc "The limit; `texts` are the sources by their paths."
  def limit(texts) do
    found =
      for {file, text} <- texts,
          not may?(file),
          places = named(text),
          places != [],
          into: %{},
          do: {file, places}

    %{
      name: :firmwares,
      most: 0,
      found: Map.new(found, fn {file, places} -> {file, length(places)} end),
      problem: fn file, n, most ->
        "#{file}: names a firmware #{n} times, #{most} at most; move what differs into #{@own}/, in lines " <>
          Enum.join(found[file], ", ")
      end
    }
  end

  defp may?(file) do
    file in [@own <> ".ex" | elsewhere()] or
      Enum.any?([@own <> "/", "apps/sim_vehicle/" | elsewhere()], &below?(file, &1))
  end

  defp below?(file, place), do: String.ends_with?(place, "/") and String.starts_with?(file, place)

  @doc "The lines of a source in which it knows a firmware by its name; what people read does not count."
  def named(text) do
    {_ast, lines} =
      text
      |> Code.string_to_quoted!(literal_encoder: &{:ok, {:literal, &2, [&1]}}, emit_warnings: false)
      |> Macro.prewalk([], &node/2)

    Enum.sort(lines)
  end

  defp node({:@, _, [{doc, _, [_text]}]}, lines) when doc in [:moduledoc, :doc, :typedoc], do: {nil, lines}

  defp node({:__aliases__, meta, parts} = node, lines) do
    if List.starts_with?(parts, @dialects) or not Enum.any?(parts, &name?/1),
      do: {node, lines},
      else: {nil, [meta[:line] | lines]}
  end

  defp node({sigil, meta, [{:<<>>, _, [text]}, _modifiers]} = node, lines)
       when sigil in [:sigil_w, :sigil_r, :sigil_s] and is_binary(text) do
    if text |> String.split(~r/\W+/) |> Enum.any?(&name?/1),
      do: {nil, [meta[:line] | lines]},
      else: {node, lines}
  end

  defp node({op, meta, [_one, _other] = both} = node, lines) when op in [:==, :!=, :===, :!==, :in],
    do: {node, if(number?(both), do: [meta[:line] | lines], else: lines)}

  defp node({{:literal, meta, [:autopilot]}, {:literal, _, [number]}} = node, lines),
    do: {node, if(number in Map.values(@numbers), do: [meta[:line] | lines], else: lines)}

  defp node({:literal, meta, [value]} = node, lines),
    do: {node, if(name?(value), do: [meta[:line] | lines], else: lines)}

  defp node(node, lines), do: {node, lines}

  defp number?(both) do
    Enum.any?(both, &match?({{:., _, [_, :autopilot]}, _, _}, &1)) and
      Enum.any?(both, &match?({:literal, _, [n]} when n in [3, 12], &1))
  end

  defp name?(value) when is_map_key(@numbers, value), do: true
  defp name?(value) when is_atom(value), do: value |> Atom.to_string() |> name?()
  defp name?(value) when is_binary(value), do: String.downcase(value) in (@names ++ @said)
  defp name?(_other), do: false
end
