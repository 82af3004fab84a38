defmodule Aerie.Control.Ftp.RecordedTest do
  @moduledoc "The client against what PX4 1.17 answered in a recorded flight, request by request."

  use ExUnit.Case, async: true

  alias Aerie.{Flight, LossyLink}
  alias Aerie.Control.Ftp.Client
  alias Aerie.Control.Params.Metadata.Unpack
  alias Aerie.Vehicle.Services.Reports.{Definitions, Names}
  alias MavCodec.Messages.FileTransferProtocol

  @fixtures Path.expand("../../../../../vehicle/test/fixtures", __DIR__)

  # What was asked with what came, without numbers. A path ends in one recording with a NUL and in another without.
  defp recorded do
    asked = payloads("px4_flight_tx.tlog")

    answers =
      Map.new(payloads("px4_flight_files.tlog"), fn <<seq::little-16, rest::binary>> -> {seq, rest} end)

    {answers, _path} =
      Enum.reduce(asked, {%{}, nil}, fn <<seq::little-16, _session, opcode, size, _::binary-size(3),
                                          offset::little-32, data::binary>>,
                                        {known, path} ->
        path = if opcode in [3, 4], do: binary_part(data, 0, size), else: path
        {Map.put_new(known, {opcode, path, offset}, answers[seq + 1]), path}
      end)

    answers
  end

  defp payloads(file) do
    for %MavCodec.Frame{id: 110} = frame <- Flight.parse(File.read!(Path.join(@fixtures, file))),
        {:ok, message} = MavCodec.decode(frame),
        do: message.payload
  end

  defp answer({known, path}, %FileTransferProtocol{payload: payload}, _now) do
    <<seq::little-16, session, opcode, size, _::binary-size(3), offset::little-32, data::binary>> = payload
    path = if opcode in [3, 4], do: binary_part(data, 0, size), else: path

    rest =
      case known[{opcode, path, offset}] do
        # It was not asked for bursts, nor beyond the end.
        nil when opcode == 15 -> <<session, 129, 1, 15, 0, 0, 0::32, 7, 0::size(238 * 8)>>
        nil -> <<session, 129, 1, opcode, 0, 0, offset::little-32, 6, 0::size(238 * 8)>>
        rest -> rest
      end

    {{known, path}, [{0, %FileTransferProtocol{payload: <<seq + 1::little-16>> <> rest}}]}
  end

  defp run(operation),
    do: LossyLink.run(Client, Client.new(operation, {1, 1}, 60_000_000), {recorded(), nil}, &answer/3)

  test "PX4's folders" do
    assert {:ok, entries} = run({:list, "/etc/extras"}).result
    assert %{kind: :file, name: "all_events.json.xz", size: 16_972} in entries
    assert Enum.all?(entries, &(&1.kind == :file))
  end

  test "PX4's files are whole: their own checksums are right" do
    run = run({:read, "/etc/extras/all_events.json.xz"})
    assert run.result == {:ok, 16_972}
    # The magic bytes of xz at both ends.
    assert <<0xFD, "7zXZ", 0, _::binary>> = bytes = LossyLink.bytes(run)
    assert binary_part(bytes, 16_970, 2) == "YZ"
    assert {:ok, text} = Unpack.file("all_events.json.xz", bytes)
    assert {:ok, %{events: events} = definitions} = Definitions.decode(text)
    assert map_size(events) == 367
    # Of this one Aerie's own file has only the name.
    throttle = 0x01000000 + 1_749_061
    assert {Names.values(throttle, <<0>>), Names.values(Names.own(definitions), throttle, <<0>>)} == {nil, []}
    # What a version has another label for.
    disarmed = 0x01F46777
    assert Names.values(disarmed, <<6>>) == ["landing"]
    assert Names.values(Names.own(definitions), disarmed, <<6>>) == ["auto_disarm_land"]
    assert run({:read, "/nope.txt"}).result == {:error, :file_not_found}
  end
end
