defmodule SimVehicle.FtpTest do
  use ExUnit.Case, async: true

  alias SimVehicle.{Ftp, Params}

  @params Params.new([{"AB", 1, 4}, {"AC", 2, 4}], :c_cast)

  defp ask(ftp, opcode, data, fields \\ []) do
    size = Keyword.get(fields, :size, byte_size(data))
    seq = Keyword.get(fields, :seq, 1)
    session = Keyword.get(fields, :session, 0)
    offset = Keyword.get(fields, :offset, 0)

    payload =
      <<seq::little-16, session, opcode, size, 0, 0, 0, offset::little-32, data::binary,
        0::size((239 - byte_size(data)) * 8)>>

    {ftp, answers} = Ftp.handle(ftp, payload, {255, 190}, @params)

    read =
      for {_after,
           <<seq::little-16, session, opcode, size, _request, complete, _padding, _offset::little-32,
             data::binary>>} <- answers,
          do: {seq, opcode, session, complete, binary_part(data, 0, size)}

    {ftp, read}
  end

  test "PX4 has one session, ArduPilot five" do
    for {style, sessions} <- [px4: 1, ardupilot: 5] do
      ftp = Ftp.new(style, %{"/a" => "x"})

      ftp =
        for n <- 1..sessions, reduce: ftp do
          ftp ->
            with {ftp, [{_seq, 128, session, 0, <<1::little-32>>}]} <- ask(ftp, 4, "/a", seq: n * 2),
                 do:
                   (
                     assert(session == n - 1)
                     ftp
                   )
        end

      assert {ftp, [{_seq, 129, _session, 0, <<5>>}]} = ask(ftp, 4, "/a", seq: 50)
      {ftp, [{_seq, 128, _session, 0, ""}]} = ask(ftp, 2, "", seq: 60)
      assert {_ftp, [{_seq, 128, 0, 0, _size}]} = ask(ftp, 4, "/a", seq: 70)
    end
  end

  test "a repeated request has no effect, and the same answer (T2)" do
    {ftp, [removed]} = ask(Ftp.new(:px4, %{"/a" => "x"}), 8, "/a", seq: 3)
    assert {4, 128, 0, 0, ""} = removed
    assert {ftp, [^removed]} = ask(ftp, 8, "/a", seq: 3)
    assert {_ftp, [{5, 129, 0, 0, <<2, 2>>}]} = ask(ftp, 8, "/a", seq: 4)
  end

  test "a burst ends as the firmware ends it (T3)" do
    for {style, last} <- [px4: {129, 0, <<6>>}, ardupilot: {128, 1, "b"}] do
      {ftp, _opened} = ask(Ftp.new(style, %{"/a" => String.duplicate("a", 239) <> "b"}), 4, "/a")
      {_ftp, answers} = ask(ftp, 15, "", size: 239, seq: 2)
      {_seq, opcode, _session, complete, data} = List.last(answers)
      assert {opcode, complete, data} == last
    end
  end

  test "ArduPilot's parameter file is read in pieces of one size" do
    {ftp, [{_seq, 128, 0, 0, <<16_704::little-32>>}]} = ask(Ftp.new(:ardupilot), 4, "@PARAM/param.pck")

    assert {ftp,
            [
              {_s, 128, 0, 0,
               <<0x671B::little-16, 2::little-16, 2::little-16, 2, 0x10, "AB", 1, 0, 2, 1, "C", 2, 0>>}
            ]} =
             ask(ftp, 5, "", size: 239, seq: 2)

    assert {_ftp, [{_s, 129, 0, 0, <<2, 22>>}]} = ask(ftp, 5, "", size: 100, seq: 3)
    assert {_ftp, [{_s, 129, 0, 0, <<2, 22>>}]} = ask(ftp, 5, "", size: 239, offset: 7, seq: 4)
    assert {_ftp, [{_s, 129, 0, 0, <<10>>}]} = ask(Ftp.new(:px4), 4, "@PARAM/param.pck")
  end

  test "nothing that comes breaks it" do
    property =
      :proper.forall(
        :proper_types.list(
          :proper_types.tuple([
            :proper_types.integer(0, 20),
            :proper_types.binary(),
            :proper_types.integer(0, 3)
          ])
        ),
        fn requests ->
          ftp =
            for {{opcode, data, session}, n} <- Enum.with_index(requests),
                reduce: Ftp.new(:ardupilot, %{"/a" => "abc"}) do
              ftp ->
                ftp
                |> ask(opcode, binary_part(data, 0, min(byte_size(data), 239)), seq: n, session: session)
                |> elem(0)
            end

          map_size(ftp.sessions) <= 5
        end
      )

    assert :proper.quickcheck(property, [:quiet, numtests: 300]) == true, inspect(:proper.counterexample())
    assert {_ftp, []} = Ftp.handle(Ftp.new(:px4), "short", {255, 190}, @params)
  end
end
