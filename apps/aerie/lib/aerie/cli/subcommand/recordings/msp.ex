defmodule Aerie.CLI.Subcommand.Recordings.Msp do
  @moduledoc """
  `aerie msp`: what went over a line with MSP, from the recording of its link, and whether the session does the same again with it
  (`Msp.Rerun`).
  """
  @behaviour Aerie.CLI.Subcommand

  alias Aerie.Base.Json
  alias Aerie.CLI.Output
  alias Aerie.Fleet.Replay.Source
  alias MavCodec.Frame
  alias MavCodec.Msp.Trace
  alias Msp.{Listing, Rerun}

  @signs %{request: ">", reply: "<", refusal: "!", mavlink: "MAVLink"}
  # That many bytes of a difference are shown.
  @shown 40

  @impl Aerie.CLI.Subcommand
  def run(%{arguments: %{"FILE" => file}, options: options, folder: folder}) do
    print = if options[:json], do: &json/1, else: &text/1

    with {:ok, lines} <- Source.all(Path.expand(file, folder), [], %{}, &item(&1, &2, print)),
         do: result(lines)
  catch
    :closed -> {0, ""}
    {:error, _why} = error -> error
  end

  # For each vehicle with MSP, by its id.
  defp item(%Frame{system: system} = frame, lines, print) do
    cond do
      is_map_key(lines, system) -> Map.update!(lines, system, &push(&1, frame, print))
      Trace.frame?(frame) -> Map.put(lines, system, push({Rerun.new(system), Listing.new()}, frame, print))
      true -> lines
    end
  end

  defp item(_damage, lines, _print), do: lines

  defp push({rerun, listing}, frame, print) do
    case Rerun.push(rerun, frame) do
      {nil, rerun} ->
        {rerun, listing}

      {entry, rerun} ->
        {lines, listing} = Listing.lines(listing, entry)
        for line <- lines, do: line |> Map.merge(%{at: frame.at, system: frame.system}) |> print.() |> put()
        {rerun, listing}
    end
  end

  defp put(line) do
    IO.puts(Aerie.Base.Printable.lines(line))
  rescue
    _ended in [ArgumentError, ErlangError] ->
      throw(with :ok <- Output.repeat("\n"), do: {:error, "standard output has ended"})
  end

  defp json(line),
    do: line |> Map.take([:at, :system, :from, :what, :name]) |> Map.merge(content(line)) |> encode()

  defp content(%{payload: nil, values: nil}), do: %{}
  defp content(%{payload: nil, values: values}), do: %{values: readable(values)}
  defp content(%{payload: payload}), do: %{payload: Base.encode16(payload, case: :lower)}

  defp text(line) do
    [
      Json.time(line.at),
      " ",
      to_string(line.system),
      " ",
      who(line),
      sign(line),
      line.name || "",
      values(line)
    ]
    |> IO.iodata_to_binary()
    |> String.trim_trailing()
  end

  defp who(%{from: program}) when is_integer(program), do: "program #{program} "
  defp who(_gateway_or_vehicle), do: ""
  defp sign(%{what: what}), do: Map.get(@signs, what, to_string(what)) <> " "

  defp values(line) do
    case content(line) do
      %{payload: ""} -> ""
      %{values: values} -> for {key, value} <- Enum.sort(values), do: " #{key}=#{encode(value)}"
      %{payload: hex} -> " 0x" <> hex
      _nothing -> ""
    end
  end

  defp encode(value), do: value |> Json.plain() |> Json.encode!()

  # Bytes that cannot be shown as text.
  defp readable(map) when is_map(map) and not is_struct(map),
    do: Map.new(map, fn {key, value} -> {key, readable(value)} end)

  defp readable(list) when is_list(list), do: Enum.map(list, &readable/1)

  defp readable(bytes) when is_binary(bytes),
    do: if(String.printable?(bytes), do: bytes, else: "0x" <> Base.encode16(bytes, case: :lower))

  defp readable(value), do: value

  defp result(lines) when lines == %{},
    do:
      {:error, "there is no MSP in this recording: record the link (recorder.links: always), not the vehicle"}

  defp result(lines) do
    outcomes = for {_system, {rerun, _listing}} <- Enum.sort(lines), do: outcome(rerun)
    IO.write(:stderr, Enum.map(outcomes, &[elem(&1, 1), ?\n]))
    {Enum.max(Enum.map(outcomes, &elem(&1, 0))), ""}
  end

  defp outcome(%{session: nil} = rerun),
    do:
      {0,
       "#{rerun.system}: #{rerun.counts.entries} entries; the recording begins after the line was opened, so nothing is compared"}

  defp outcome(%{difference: nil, counts: counts} = rerun) do
    {0,
     "#{rerun.system}: #{counts.entries} entries; done again: the same #{counts.writes} writes and #{counts.frames} MAVLink frames"}
  end

  defp outcome(%{difference: difference} = rerun) do
    {1,
     "#{rerun.system}: done again, the #{difference.what} of #{Json.time(difference.at)} differs: " <>
       "recorded #{hex(difference.recorded)}, now #{hex(difference.here)}"}
  end

  defp hex(""), do: "nothing"
  defp hex(bytes), do: bytes |> binary_slice(0, @shown) |> Base.encode16(case: :lower)
end
