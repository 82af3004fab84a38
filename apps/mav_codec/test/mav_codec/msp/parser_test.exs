defmodule MavCodec.Msp.ParserTest do
  use ExUnit.Case, async: true

  import MavCodec.Test.Msp, only: [frame: 0, let: 2, noise: 0]

  alias MavCodec.Msp.{Frame, Parser}
  alias MavCodec.Test.MspTranscript

  doctest MavCodec.CRC.DvbS2

  defp holds(property, tests \\ 300),
    do: assert(:proper.quickcheck(property, [:quiet, {:numtests, tests}]) == true)

  defp parse(bytes), do: bytes |> List.wrap() |> Enum.reduce({[], Parser.new()}, &push/2)

  defp push(bytes, {frames, parser}) do
    {more, parser} = Parser.push(parser, bytes)
    {frames ++ more, parser}
  end

  defp all(bytes) do
    {frames, parser} = parse(bytes)
    frames ++ expired(parser)
  end

  defp expired(parser) do
    case Parser.expire(parser) do
      {frames, parser} -> if Parser.pending(parser) == "", do: frames, else: frames ++ expired(parser)
    end
  end

  # By the definition of a frame: a place where the bytes are those of a frame that is written.
  defp brute(""), do: []

  defp brute(<<_byte, next::binary>> = bytes) do
    case Enum.find(candidates(bytes), &String.starts_with?(bytes, Frame.encode(&1))) do
      nil -> brute(next)
      frame -> [frame | bytes |> binary_slice(byte_size(Frame.encode(frame))..-1//1) |> brute()]
    end
  end

  defp candidates(<<"$", letter, direction, rest::binary>>) when letter in ~c"MX" and direction in ~c"<>!" do
    direction = %{?< => :request, ?> => :reply, ?! => :error}[direction]
    Enum.map(candidates(letter, rest), &%{&1 | direction: direction})
  end

  defp candidates(_bytes), do: []

  defp candidates(?X, <<flags, id::16-little, n::16-little, payload::binary-size(n), _::binary>>),
    do: [%Frame{form: :v2, id: id, flags: flags, payload: payload}]

  defp candidates(
         ?M,
         <<255, 255, flags, id::16-little, n::16-little, _::16, payload::binary-size(n), _::binary>>
       ),
       do: [%Frame{form: :v2_over_v1, id: id, flags: flags, payload: payload}]

  defp candidates(?M, <<_, 255, flags, id::16-little, n::16-little, payload::binary-size(n), _::binary>>),
    do: [%Frame{form: :v2_over_v1, id: id, flags: flags, payload: payload}]

  defp candidates(?M, <<255, id, n::16-little, payload::binary-size(n), _::binary>>) when id < 255,
    do: [%Frame{id: id, payload: payload}]

  defp candidates(?M, <<n, id, payload::binary-size(n), _::binary>>) when id < 255,
    do: [%Frame{id: id, payload: payload}]

  defp candidates(_letter, _rest), do: []

  describe "forms (Q1)" do
    test "each as firmware sends it" do
      assert {[%Frame{form: :v1, direction: :reply, id: 1, payload: <<0, 1, 46>>}], _} =
               parse("$M>" <> <<3, 1, 0, 1, 46, 45>>)

      assert {[%Frame{form: :v1, direction: :error, id: 250, payload: ""}], _} =
               parse("$M!" <> <<0, 250, 250>>)

      assert {[%Frame{form: :v2, direction: :request, id: 0x3006, payload: <<2>>}], _} =
               parse("$X<" <> <<0, 6, 0x30, 1, 0, 2, 197>>)
    end

    test "a jumbo frame has its size behind the id, and in version 2 over 1 behind the inner header" do
      names = :binary.copy("ARM;", 80)
      v1 = Frame.encode(%Frame{id: 116, direction: :reply, payload: names})
      assert <<"$M>", 255, 116, 320::16-little, ^names::binary-size(320), _>> = v1
      both = Frame.encode(%Frame{form: :v2_over_v1, id: 116, direction: :reply, payload: names})

      assert <<"$M>", 255, 255, 0, 116::16-little, 320::16-little, 326::16-little, ^names::binary-size(320),
               _, _>> =
               both

      assert {[%Frame{payload: ^names}, %Frame{payload: ^names}], _} = parse(v1 <> both)
    end

    test "whatever the frame: written and read, it is the same" do
      holds(
        :proper.forall(frame(), fn frame -> match?({[^frame], %{buffer: ""}}, parse(Frame.encode(frame))) end)
      )
    end
  end

  describe "a stream" do
    test "gives the same frames however it is cut, and those that a search by definition finds" do
      stream = let(:proper_types.list(:proper_types.oneof([frame(), noise(), cut()])), &join/1)

      holds(
        :proper.forall({stream, :proper_types.vector(6, :proper_types.range(1, 60))}, fn {bytes, sizes} ->
          {frames, parser} = parse(bytes)
          {^frames, ^parser} = parse(pieces(bytes, sizes))
          all(bytes) == brute(bytes)
        end)
      )
    end

    test "loses no frame to one that is damaged, and counts it" do
      good = Frame.encode(%Frame{id: 108, direction: :reply, payload: "abcdef"})
      <<head::binary-size(8), byte, rest::binary>> = good
      damaged = <<head::binary, Bitwise.bxor(byte, 1), rest::binary>>
      {frames, parser} = parse(["noise", good, damaged, good])
      assert length(frames) == 2

      assert Parser.counters(parser) == %{
               frames: 2,
               skipped: 5 + byte_size(good),
               checksum: 1,
               oversize: 0,
               expired: 0
             }
    end

    test "half a frame waits until it is given up; what began inside it is then found" do
      reply = Frame.encode(%Frame{id: 108, direction: :reply, payload: "abcdef"})
      {[], parser} = parse(["$M>" <> <<200, 1>>, reply])
      assert Parser.pending(parser) == "$M>" <> <<200, 1>> <> reply
      assert {[%Frame{id: 108}], parser} = Parser.expire(parser)
      assert Parser.pending(parser) == ""
      assert %{expired: 1, frames: 1, skipped: 5} = Parser.counters(parser)
      assert {[], ^parser} = Parser.expire(parser)
    end

    test "the echo of a command line stays visible" do
      for echo <- ["$M<", "$X<"] do
        {[], parser} = parse(echo)
        assert Parser.pending(parser) == echo
      end
    end

    test "a size beyond any firmware's is not a frame" do
      {[%Frame{id: 2}], parser} = parse(["$X>" <> <<0, 1, 0, 0xFFFF::16>>, Frame.encode(%Frame{id: 2})])
      assert %{oversize: 1} = Parser.counters(parser)
    end

    test "takes bytes of any kind" do
      holds(
        :proper.forall(:proper_types.binary(), fn bytes ->
          {_frames, parser} = parse(bytes)
          byte_size(Parser.pending(parser)) <= byte_size(bytes)
        end)
      )
    end
  end

  test "the work for a byte is bounded, whatever the bytes are" do
    plain = work(:binary.copy(<<0>>, 60_000))
    inner = <<0, 1, 0, 2000::16-little>>

    hostile = [
      :binary.copy("$", 60_000),
      :binary.copy("$M>" <> <<254, 1>>, 12_000),
      :binary.copy("$M>" <> <<255, 1, 2000::16-little>>, 8_571),
      :binary.copy("$X>" <> inner, 7_500),
      :binary.copy("$M>" <> <<255, 255>> <> inner <> <<2006::16-little>>, 5_000)
    ]

    for bytes <- hostile, do: assert(work(bytes) < 20 * plain)
  end

  defp work(bytes) do
    {:reductions, before} = Process.info(self(), :reductions)
    {_frames, _parser} = parse(pieces(bytes, [1000]))
    {:reductions, behind} = Process.info(self(), :reductions)
    behind - before
  end

  for firmware <- [:betaflight, :inav] do
    test "every reply of #{firmware} is one frame, and written again it is the same bytes" do
      for {_asked, _answered, request, reply} <- MspTranscript.read(unquote(firmware)), reply != nil do
        assert {[frame], %{buffer: ""}} = parse(reply)
        assert Frame.encode(frame) == reply
        # Requests that the recording damaged on purpose are not whole.
        for request <- all(request), do: assert(request.id == frame.id and request.form == frame.form)
      end
    end
  end

  defp cut, do: let({frame(), :proper_types.range(1, 8)}, fn {frame, n} -> {:cut, frame, n} end)

  defp join(parts), do: parts |> Enum.map(&part/1) |> IO.iodata_to_binary()
  defp part(%Frame{} = frame), do: Frame.encode(frame)

  defp part({:cut, frame, n}) do
    bytes = Frame.encode(frame)
    binary_part(bytes, 0, max(byte_size(bytes) - n, 0))
  end

  defp part(noise), do: noise

  defp pieces("", _sizes), do: []

  defp pieces(bytes, [size | sizes]) do
    size = min(size, byte_size(bytes))
    [binary_part(bytes, 0, size) | pieces(binary_part(bytes, size, byte_size(bytes) - size), sizes ++ [size])]
  end
end
