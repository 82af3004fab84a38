defmodule Msp.ClientsTest do
  @moduledoc "Programs that speak MSP share one flight controller: what each may do, whose reply is whose, and what is left when one is gone."
  use ExUnit.Case, async: true

  alias MavCodec.Messages, as: M
  alias MavCodec.Msp.{Frame, Parser}
  alias Msp.Test.{Line, Simulated}
  alias SimVehicle.Msp.Firmware

  @second 1_000_000

  defp up(firmware, options \\ [], rest \\ []) do
    {answer, change, state} = Simulated.controller(firmware, options)
    line = Line.open(fn bytes, us -> with("" <- answer.(bytes, us), do: nil) end, rest)
    {line |> Line.run(7 * @second) |> program(1), change, state}
  end

  defp program(line, id), do: Line.handle(line, {:client, id, :up})

  defp ask(line, id, frames, seconds \\ 0.3) do
    bytes = for frame <- List.wrap(frames), do: if(is_binary(frame), do: frame, else: Frame.encode(frame))
    line |> Line.handle({:client, id, IO.iodata_to_binary(bytes)}) |> Line.run(round(seconds * @second))
  end

  defp v1(id, payload \\ ""), do: %Frame{id: id, payload: payload}
  defp v2(id, payload \\ ""), do: %Frame{form: :v2, id: id, payload: payload}

  # What a program got, decoded.
  defp got(line, id) do
    bytes = for {_at, ^id, bytes} <- Enum.reverse(line.clients), into: <<>>, do: bytes
    elem(Parser.push(Parser.new(), bytes), 0)
  end

  defp notes(line), do: Enum.join(for({_at, text} <- Line.told(line, M.Statustext), do: text.text))

  defp sent(line, id),
    do:
      for(
        {_at, bytes} <- Enum.reverse(line.written),
        {[%{id: ^id} = frame], _} <- [Parser.push(Parser.new(), bytes)],
        do: frame
      )

  test "each gets its own replies, in its own form, while the vehicle's state goes on" do
    {line, _change, _state} = up(:betaflight)
    line = line |> program(2) |> ask(1, [v1(1), v1(2), v1(112)], 0) |> ask(2, [v2(2), v2(160)], 1)

    assert [
             %{id: 1, form: :v1, payload: <<0, 1, 46>>},
             %{id: 2, payload: "BTFL"},
             %{id: 112, direction: :reply}
           ] = got(line, 1)

    assert [%{id: 2, form: :v2, payload: "BTFL"}, %{id: 160, form: :v2}] = got(line, 2)
    beats = for {at, _} <- Line.told(line, M.Heartbeat), do: at
    assert beats |> Enum.chunk_every(2, 1, :discard) |> Enum.all?(fn [a, b] -> b - a < 1.4 * @second end)
  end

  # A line on which each reply is lost that is to be.
  defp losing(firmware, lost?) do
    {answer, _change, _state} = Simulated.controller(firmware)
    counter = :counters.new(1, [])

    line =
      Line.open(fn bytes, us ->
        reply = answer.(bytes, us)
        :counters.add(counter, 1, 1)

        if reply == "" or (us > 7 * @second and lost?.(:counters.get(counter, 1), bytes)),
          do: nil,
          else: reply
      end)

    line |> Line.run(7 * @second) |> program(1)
  end

  # A program that reads without end, and asks again after a second.
  defp reading(line, seconds) do
    Enum.reduce(1..(seconds * 50), {line, 0, line.now}, fn _turn, {line, had, asked} ->
      got = length(got(line, 1))

      if got > had or line.now - asked > @second or asked == line.now,
        do: {ask(line, 1, v1(Enum.random([112, 34, 94, 111, 10])), 0.02), got, line.now},
        else: {Line.run(line, 20_000), had, asked}
    end)
    |> elem(0)
  end

  defp attitudes(line), do: length(Line.told(line, M.Attitude))

  defp gap(line, module),
    do:
      line
      |> Line.told(module)
      |> Enum.map(&elem(&1, 0))
      |> Enum.chunk_every(2, 1, :discard)
      |> Enum.map(fn [a, b] -> b - a end)
      |> Enum.max()

  test "on a line that loses a tenth of all replies a program that reads costs the vehicle's state next to nothing" do
    for firmware <- [:betaflight, :inav] do
      :rand.seed(:exsss, {1, 2, 3})
      lost? = fn _n, _bytes -> :rand.uniform() < 0.1 end
      alone = losing(firmware, lost?)
      before = attitudes(alone)
      alone = Line.run(alone, 16 * @second)
      line = reading(losing(firmware, lost?), 16)
      assert attitudes(alone) - before > 60
      assert attitudes(line) - before > 60
      assert gap(line, M.Heartbeat) < 2 * @second
      assert gap(line, M.Attitude) < 1.2 * @second
      assert length(got(line, 1)) > 50
    end
  end

  test "whatever a program asks for, and however long that may take: a lost reply does not silence the vehicle" do
    for {id, payload} <- [{112, ""}, {250, ""}, {0x3010, "p_roll"}, {202, <<45::8, 0::112>>}] do
      line =
        losing(:betaflight, fn _n, bytes -> match?({[%{id: ^id}], _}, Parser.push(Parser.new(), bytes)) end)

      before = attitudes(line)
      line = ask(line, 1, %Frame{form: if(id > 254, do: :v2, else: :v1), id: id, payload: payload}, 5)
      assert attitudes(line) - before > 20
      assert gap(line, M.Attitude) < 600_000
      # And the next one's turn comes, sooner if it is one that does not take long.
      line = if id == 250, do: line, else: ask(line, 1, v1(10), 0.5)
      assert id == 250 or Enum.any?(got(line, 1), &(&1.id == 10))
    end
  end

  test "the reply to version 2 keeps the flags of its request, by which programs number them" do
    for firmware <- [:betaflight, :inav], form <- [:v2, :v2_over_v1] do
      {line, _change, _state} = up(firmware)
      asked = for flags <- [0, 0x40, 0xFC], do: %{v2(2) | form: form, flags: flags}
      line = ask(line, 1, asked ++ [%{v2(0x7777) | form: form, flags: 0x42}], 1)

      assert for(frame <- got(line, 1), do: {frame.id, frame.form, frame.flags, frame.direction}) == [
               {2, form, 0, :reply},
               {2, form, 0x40, :reply},
               {2, form, 0xFC, :reply},
               {0x7777, form, 0x42, :error}
             ]

      # What goes to the flight controller is the gateway's own, with none.
      assert Enum.all?(sent(line, 2), &(&1.flags == 0))
    end
  end

  test "iNav answers none whose lowest flag says so" do
    {line, _change, _state} = up(:inav)
    line = ask(line, 1, [%{v2(2) | flags: 1}, %{v2(0x7777) | flags: 0x41}, %{v2(2) | flags: 0x20}], 1)
    assert [%{id: 2, flags: 0x20}] = got(line, 1)
  end

  test "what is not a request of this firmware, or would harm it, is refused and never written; nothing outside frames is" do
    {line, _change, _state} = up(:betaflight)
    before = length(line.written)
    garbage = "#\nR exit\n"

    bad = [
      v1(202, <<1, 2>>),
      v1(245),
      v1(68, <<1>>),
      v1(200, <<1500::16-little>>),
      v2(9_999),
      v1(230, <<202>>),
      v2(112, :binary.copy("x", 193))
    ]

    line = ask(line, 1, [garbage | bad], 1)
    assert Enum.map(got(line, 1), &{&1.id, &1.direction}) == Enum.map(bad, &{&1.id, :error})
    for id <- [202, 245, 68, 200, 9_999, 230], do: assert(sent(line, id) == [])
    assert length(line.written) > before
    assert Enum.all?(line.written, fn {_at, bytes} -> String.starts_with?(bytes, ["$M<", "$X<"]) end)
    assert notes(line) =~ "SET_RAW_RC is not for programs"
  end

  test "settings by name: to read one is nobody's business, to set one is judged by its name" do
    {line, _change, state} =
      up(:betaflight, [api: {1, 48}], judge: fn %{param_id: name} -> name == "acc_lpf_hz" end)

    reading = v2(0x3010, "acc_lpf_hz" <> :binary.copy(<<0>>, 60))

    line =
      ask(
        line,
        1,
        [
          reading,
          v2(0x3010, "acc_lpf_hz = 40"),
          v2(0x3010, "failsafe_delay=1"),
          v2(0x3011, "p_roll" <> <<0>>)
        ],
        2
      )

    assert [
             %{direction: :reply, payload: "acc_lpf_hz = 25"},
             %{direction: :reply, payload: "acc_lpf_hz = 40"},
             %{direction: :error},
             %{direction: :reply}
           ] = got(line, 1)

    assert for(%M.ParamSet{param_id: id} <- Enum.reverse(line.judged), do: id) == [
             "acc_lpf_hz",
             "failsafe_delay"
           ]

    assert state.().settings["acc_lpf_hz"] == 40
  end

  test "a write is judged as what it means in MAVLink, and refused if the policy says so" do
    {line, _change, state} = up(:betaflight, [], judge: fn _message -> false end)
    set_pid = v1(202, :binary.copy(<<30>>, 15))
    before = state.().blocks

    line =
      ask(
        line,
        1,
        [set_pid, v1(68), v1(250), v1(214, :binary.copy(<<0xE8, 3>>, 8)), v1(99, <<1, 0>>), v1(206)],
        2
      )

    assert Enum.map(got(line, 1), & &1.direction) == List.duplicate(:error, 6)
    assert state.().blocks == before and state.().events == []
    judged = Enum.reverse(line.judged)

    assert [
             %M.ParamSet{target_system: 42, param_id: pid},
             %M.CommandLong{command: 246},
             %M.CommandLong{command: 245, param1: 1.0},
             %M.CommandLong{command: 209},
             %M.CommandLong{command: 400, param1: +0.0},
             %M.CommandLong{command: 241}
           ] = judged

    assert pid =~ "roll" or pid =~ "p_"
  end

  test "iNav's settings by name, missions and what has no counterpart" do
    {line, _change, state} = up(:inav)
    name = "nav_rth_altitude"

    line =
      ask(
        line,
        1,
        [v2(0x1004, name <> <<0, 1, 2>>), v2(0x1004, <<0, 3, 0, 1>>), v1(209, <<1, 4, 0::144, 165>>)],
        1
      )

    assert [%M.ParamSet{param_id: ^name}, %M.ParamSet{param_id: "failsafe_delay"}, %M.MissionCount{}] =
             Enum.reverse(line.judged)

    assert [%{direction: :reply}, _, %{id: 209, direction: :reply}] = got(line, 1)
    assert state.().settings[name] == <<1, 2>>
    assert length(state.().mission.list) == 1
  end

  test "nothing that is not for armed vehicles reaches one, whatever the policy says" do
    {line, change, state} = up(:betaflight)
    change.(&Firmware.sticks(&1, [1500, 1500, 1000, 1500, 1900, 1000, 1000, 1000]))
    line = Line.run(line, @second)
    assert state.().armed
    line = ask(line, 1, [v1(68), v1(250), v1(99, <<1, 0>>), v1(101)], 1)

    assert [%{direction: :error}, %{direction: :error}, %{direction: :error}, %{id: 101, direction: :reply}] =
             got(line, 1)

    assert state.().armed and state.().boots == 1
    assert line.judged == []
  end

  test "channels are not for programs, by whichever message, armed or not" do
    {answer, change, _state} = Simulated.controller(:inav, rx_msp: true)
    change.(&%{&1 | version: {9, 1}, blocks: Map.put(&1.blocks, 3, <<9, 1, 0>>)})
    line = Line.open(fn bytes, us -> with("" <- answer.(bytes, us), do: nil) end)
    line = line |> Line.run(7 * @second) |> program(1)
    line = ask(line, 1, [v2(0x2230, <<0, 0xFF, 0xFF>>), v1(200, :binary.copy(<<0xDC, 5>>, 16))], 1)
    assert [%{id: 0x2230, direction: :error}, %{id: 200, direction: :error}] = got(line, 1)
    assert sent(line, 0x2230) == [] and line.judged == []
    assert notes(line) =~ "MSP2_INAV_SET_AUX_RC is not for programs"
  end

  for firmware <- [:betaflight, :inav] do
    test "#{firmware}: a range of the arm switch in which the switch is already would arm it, and is not written" do
      {line, _change, state} = up(unquote(firmware))
      # Its first auxiliary channel is at 1000 µs: the fourth step of 25 above 900.
      high = v1(35, <<0, 0, 0, 32, 48>>)
      here = v1(35, <<0, 0, 0, 0, 12>>)
      line = ask(line, 1, [high, here], 1)
      assert [%{direction: :reply}, %{direction: :error}] = got(line, 1)
      assert [%{payload: <<0, 0, 0, 32, 48>>}] = sent(line, 35)
      assert notes(line) =~ "so that it would arm"
      line = Line.run(line, 2 * @second)
      refute state.().armed
      # Another mode's range may be there, and an empty one arms nothing.
      line = ask(line, 1, [v1(35, <<1, 1, 0, 0, 12>>), v1(35, <<0, 0, 0, 0, 0>>)], 1)
      assert [_, _, %{direction: :reply}, %{direction: :reply}] = got(line, 1)
    end
  end

  test "a program that keeps it disarmed may set the range of its arm switch, but links it to no mode otherwise" do
    {line, _change, state} = up(:betaflight)
    line = ask(line, 1, [v1(35, <<0, 0, 0, 0, 0, 0, 1>>), v1(99, <<1, 0>>), v1(35, <<0, 0, 0, 0, 12>>)], 1)
    assert [%{direction: :error}, %{direction: :reply}, %{id: 35, direction: :reply}] = got(line, 1)
    refute state.().armed
  end

  test "a program's write that waits while the vehicle is armed is not sent" do
    {line, change, state} = up(:betaflight)
    before = state.().blocks[64]
    # All in one packet, the arming between them and the next STATUS.
    change.(&%{Firmware.sticks(&1, [1500, 1500, 1000, 1500, 1900]) | armed: true})
    line = Line.run(line, 400_000)
    line = ask(line, 1, List.duplicate(v1(65, <<1, 0, 2, 3, 4, 5, 6, 7>>), 3), 2)
    assert state.().armed and state.().blocks[64] == before
    assert sent(line, 65) == []
    # A log's memory is not read from one either.
    line = ask(line, 1, v1(71, <<0::32, 16, 0, 0>>), 1)
    assert sent(line, 71) == []
  end

  test "arming that a program disabled is enabled when it is gone, but not while another one wants it so" do
    {line, _change, state} = up(:betaflight)
    line = line |> program(2) |> ask(1, v1(99, <<1, 0>>)) |> ask(2, v1(99, <<1, 0>>))
    assert state.().ports.port.disabled
    line = line |> Line.handle({:client, 1, :down}) |> Line.run(@second)
    assert state.().ports.port.disabled
    line = line |> Line.handle({:client, 2, :down}) |> Line.run(@second)
    refute state.().ports.port.disabled
    assert notes(line) =~ "it is enabled again"
    assert length(sent(line, 99)) == 2
    # The line is closed in order: enabled before that.
    line = line |> program(3) |> ask(3, v1(99, <<1, 0>>))
    assert state.().ports.port.disabled
    {_session, actions} = Msp.Session.handle(line.session, :closing, line.now)
    assert [{:write, <<"$M<", 2, 99, 0, 0, _>>}] = actions
  end

  test "arming that another life of this gateway left disabled is enabled" do
    {answer, change, state} = Simulated.controller(:betaflight)
    change.(&put_in(&1.ports.port.disabled, true))
    line = Line.open(fn bytes, us -> with("" <- answer.(bytes, us), do: nil) end) |> Line.run(7 * @second)
    refute state.().ports.port.disabled
    assert length(sent(line, 99)) == 1
  end

  test "motors that a program turned are stopped when it is gone, and when it says nothing of them for ten seconds" do
    motors = fn state -> for(<<us::16-little <- state.().blocks[104]>>, do: us) end

    for firmware <- [:betaflight, :inav],
        # With DSHOT each value above the one that stops turns a motor.
        us <- [1001, 1045, 1200],
        ending <- [
          &(&1 |> Line.handle({:client, 1, :down}) |> Line.run(@second)),
          &Line.run(&1, 12 * @second)
        ] do
      {line, _change, state} = up(firmware)
      line = ask(line, 1, v1(214, <<us::16-little>> <> :binary.copy(<<1000::16-little>>, 7)))
      assert Enum.max(motors.(state)) == us
      ending.(line)
      assert Enum.max(motors.(state)) == 1000
    end
  end

  test "motors that turn both ways are left alone: what stops others would turn them backwards" do
    {answer, change, state} = Simulated.controller(:betaflight)
    change.(&%{&1 | blocks: Map.update!(&1.blocks, 36, fn <<f::32-little>> -> <<f + 4096::32-little>> end)})

    line =
      Line.open(fn bytes, us -> with("" <- answer.(bytes, us), do: nil) end)
      |> Line.run(7 * @second)
      |> program(1)

    line = ask(line, 1, v1(214, :binary.copy(<<1500::16-little>>, 8)))
    assert [%{id: 214, direction: :error}] = got(line, 1)
    line = line |> Line.handle({:client, 1, :down}) |> Line.run(12 * @second)
    assert sent(line, 214) == []
    assert notes(line) =~ "turn both ways"
    assert Enum.max(for(<<us::16-little <- state.().blocks[104]>>, do: us)) == 1000
  end

  test "a restart that a program asked for: its reply, then the vehicle again, and its programs go on" do
    {line, _change, state} = up(:betaflight)
    line = ask(line, 1, v1(68), 8)
    assert [%{id: 68, direction: :reply}] = got(line, 1)
    assert state.().boots == 2
    line = ask(line, 1, v1(2), 1)
    assert [_, %{id: 2, payload: "BTFL"}] = got(line, 1)
  end

  test "a program that floods is refused beyond its limit, and neither the vehicle nor others wait for it" do
    {line, _change, _state} = up(:betaflight)
    line = program(line, 2)
    line = Line.handle(line, {:client, 1, IO.iodata_to_binary(for _n <- 1..1000, do: Frame.encode(v1(112)))})
    line = ask(line, 2, v1(2), 0.5)
    assert [%{id: 2}] = got(line, 2)
    line = Line.run(line, 2 * @second)
    {replies, refusals} = Enum.split_with(got(line, 1), &(&1.direction == :reply))
    assert length(replies) == 16 and length(refusals) == 984
    last = for {at, _} <- Line.told(line, M.Heartbeat), do: at
    assert line.now - 1_000_000_000_000 - List.last(last) < 1.5 * @second
    # No more than there is room for.
    line = Enum.reduce(3..12, line, &program(&2, &1))
    assert map_size(line.session.clients.map) == 8
    assert line.full == [12, 11, 10, 9]
  end

  test "another program by the number of one that is gone: what that one left is undone" do
    {line, _change, state} = up(:betaflight)
    line = ask(line, 1, v1(99, <<1, 0>>))
    assert state.().ports.port.disabled
    line = line |> program(1) |> Line.run(2 * @second)
    refute state.().ports.port.disabled
    assert [%{id: 2}] = line |> ask(1, v1(2)) |> got(1) |> Enum.drop(1)
  end

  test "any bytes of any programs, coming and going: never an error, and one checked request at a time" do
    event =
      :proper_types.frequency([
        {3, {:client, :proper_types.range(1, 3), :proper_types.binary()}},
        {6,
         {:client, :proper_types.range(1, 3),
          :proper_types.oneof(
            Enum.map(
              [
                v1(2),
                v1(202, :binary.copy(<<1>>, 15)),
                v1(99, <<1, 0>>),
                v1(68),
                v2(250),
                v1(214, :binary.copy(<<0xE8, 3>>, 8))
              ],
              &Frame.encode/1
            )
          )}},
        {1, {:client, :proper_types.range(1, 3), :up}},
        {1, {:client, :proper_types.range(1, 3), :down}},
        {4, {:wait, :proper_types.range(1, 2_000)}}
      ])

    property =
      :proper.forall(
        {:proper_types.oneof([:betaflight, :inav]), :proper_types.boolean(), :proper_types.list(event)},
        fn {firmware, allowed?, events} ->
          {line, _change, state} = up(firmware, [], judge: fn _message -> allowed? end)

          line =
            Enum.reduce(events, line, fn
              {:wait, ms}, line -> Line.run(line, ms * 1000)
              event, line -> Line.handle(line, event)
            end)

          line = Enum.reduce(1..3, line, &Line.handle(&2, {:client, &1, :down})) |> Line.run(15 * @second)

          frames? =
            Enum.all?(line.written, fn {_at, bytes} -> match?({[_], _}, Parser.push(Parser.new(), bytes)) end)

          frames? and line.failed == nil and not (firmware == :betaflight and state.().ports.port.disabled)
        end
      )

    assert :proper.quickcheck(property, [:quiet, numtests: 60, max_size: 20]) == true,
           inspect(:proper.counterexample())
  end
end
