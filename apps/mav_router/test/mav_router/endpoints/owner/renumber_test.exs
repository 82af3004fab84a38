defmodule MavRouter.Endpoints.Owner.RenumberTest do
  use ExUnit.Case, async: true

  alias MavRouter.Forward.Table.Path
  alias MavRouter.Endpoints.Owner.Renumber
  alias MavCodec.Messages, as: M
  alias MavCodec.Parser

  @way %Path{key: {"r", :self}, owner: "r", side: :vehicle, networks: ["north"]}
  @offsets %{"north" => 10}

  defp check(property, n \\ 300), do: assert(:proper.quickcheck(property, [:quiet, numtests: n]) == true)

  defp parse(bytes) do
    {[frame], parser} = Parser.push(Parser.new(), bytes, 7)
    0 = Parser.stats(parser).crc_errors
    frame
  end

  defp frame(message, options), do: message |> MavCodec.encode(options) |> parse()
  defp outward(frame, theirs? \\ fn _ -> false end), do: Renumber.outward(@offsets, @way, frame, theirs?)

  test "offsets are networks with numbers; none of them is nothing" do
    assert Renumber.compile(%{"a" => 5, "b" => 0}) == {:ok, %{"a" => 5}}
    assert Renumber.compile(%{"a" => 0}) == {:ok, nil}
    assert Renumber.compile(nil) == {:ok, nil}

    for wrong <- [%{"a" => -1}, %{"a" => 239}, %{"a" => 1.0}, %{1 => 1}, ["a"]],
        do: assert({:error, _} = Renumber.compile(wrong))
  end

  test "ids there and back" do
    for id <- 1..229,
        do: assert(Renumber.meant(@offsets, "north", Renumber.seen(@offsets, "north", id)) == id)

    assert Renumber.meant(@offsets, "south", 7) == 7
    # Nobody in that network can be meant by it.
    assert Renumber.meant(@offsets, "north", 10) == nil
    for station <- [0, 240, 245, 255], do: assert(Renumber.meant(@offsets, "north", station) == station)
    assert Renumber.seen(@offsets, "north", 255) == 255
  end

  test "what comes out is a whole frame that says the same of another system, in both versions" do
    bytes = :proper_types.binary()

    message =
      {:proper_types.range(1, 229), :proper_types.range(0, 255), :proper_types.range(1, 2),
       :proper_types.integer(), bytes}

    check(
      :proper.forall(message, fn {system, seq, version, number, bytes} ->
        for message <- [
              %M.Attitude{time_boot_ms: abs(number), roll: number / 7},
              %M.Statustext{
                severity: 3,
                text: for(<<b <- bytes>>, b in 32..126, into: "", do: <<b>>) |> String.slice(0, 40)
              },
              %M.CommandAck{command: abs(number), target_system: 255, target_component: 190}
            ] do
          original = frame(message, system: system, component: 1, seq: seq, version: version)
          {:ok, changed} = outward(original)
          # As anybody reads it who checks the CRC.
          read = parse(changed.bytes)

          {read.system, read.seq, read.version, read.payload, read.crc_extra, read.at} ==
            {system + 10, seq, version, original.payload, original.crc_extra, 7} and read == changed
        end
        |> Enum.all?()
      end)
    )
  end

  test "an addressee within the network is renumbered too, one at the client's end or a station is not" do
    command =
      &frame(%M.CommandLong{target_system: &1, target_component: 100, command: 400, param1: 1.0},
        system: 1,
        component: 1
      )

    target = fn {:ok, frame} ->
      {:ok, message} = frame.bytes |> parse() |> MavCodec.decode()
      {message.target_system, message.target_component, message.command, message.param1}
    end

    assert target.(outward(command.(1))) == {11, 100, 400, 1.0}
    assert target.(outward(command.(255))) == {255, 100, 400, 1.0}
    assert target.(outward(command.(7), &(&1 == 7))) == {7, 100, 400, 1.0}
    assert target.(outward(command.(0))) == {0, 100, 400, 1.0}
    assert target.(Renumber.inward(command.(11), 1)) == {1, 100, 400, 1.0}
    assert {:ok, %{system: 1}} = Renumber.inward(command.(11), 1)
  end

  test "an addressee that was cut off stays cut off (F10)" do
    cut = frame(%M.ParamRequestList{}, system: 1, component: 1)
    assert byte_size(cut.payload) == 1
    assert {:ok, %{payload: payload, system: 11}} = outward(cut)
    assert payload == cut.payload
  end

  test "a wrong CRC stays wrong, and that of an unknown message right" do
    # An extra byte of 99, which nobody here knows.
    body = <<3, 0, 0, 5, 1, 1, 0xABCDEF::24-little, 1, 2, 3>>
    crc = MavCodec.CRC.x25(body <> <<99>>)
    {[unknown], _} = Parser.push_datagram(Parser.new(), <<0xFD, body::binary, crc::16-little>>, 0)
    assert unknown.crc_extra == nil
    {:ok, changed} = outward(unknown)
    <<0xFD, new::binary-size(12), crc::16-little>> = changed.bytes
    assert new == <<3, 0, 0, 5, 11, 1, 0xABCDEF::24-little, 1, 2, 3>>
    assert MavCodec.CRC.x25(new <> <<99>>) == crc

    good = frame(%M.Attitude{roll: 1.0}, system: 1, component: 1)
    size = byte_size(good.bytes) - 1
    <<head::binary-size(^size), last>> = good.bytes
    wrong = MavCodec.Frame.from_bytes(head <> <<Bitwise.bxor(last, 1)>>, nil)
    {:ok, changed} = outward(wrong)
    assert {[], parser} = Parser.push_datagram(Parser.new(), changed.bytes, 0)
    assert Parser.stats(parser).crc_errors == 1
  end

  test "what is signed, too high or long is refused; what need not change is not touched" do
    signing = MavCodec.Signing.new(:binary.copy(<<7>>, 32), link_id: 3)
    {signed, _} = MavCodec.Signing.encode(signing, %M.Attitude{}, system: 1, component: 1)
    signed = parse(signed)
    assert outward(signed) == :refused
    assert Renumber.outward(%{"south" => 10}, @way, signed, & &1) == {:ok, signed}
    assert outward(frame(%M.Attitude{}, system: 230, component: 1)) == :refused
    long = %{frame(%M.Attitude{}, system: 1, component: 1) | incompat: 2}
    assert outward(long) == :refused

    for source <- [[system: 255, component: 190], [system: 51, component: 68], [system: 245, component: 191]] do
      frame = frame(%M.RadioStatus{rssi: 5}, source)
      assert outward(frame) == {:ok, frame}
    end
  end
end
