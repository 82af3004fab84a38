defmodule Msp.ArmedTest do
  @moduledoc "What is not for armed vehicles is sent, by each way, only to one that is known to be disarmed."
  use ExUnit.Case, async: true

  alias MavCodec.Messages, as: M
  alias MavCodec.Msp.{Frame, Messages, Parser}
  alias Msp.Session.Tasks.Armed
  alias Msp.Test.{Controller, Line, Simulated}
  alias SimVehicle.Msp.Firmware

  @second 1_000_000
  @armed [1500, 1500, 1000, 1500, 1900, 1000, 1000, 1000, 1000]

  # A vehicle whose answers are lost while `cut` says so, all or those that say whether it is armed: its requests
  # arrive.
  defp up(firmware) do
    {answer, change, state} = Simulated.controller(firmware)
    {:ok, cut} = Agent.start_link(fn -> nil end)

    line =
      Line.open(fn bytes, us ->
        reply = answer.(bytes, us)
        if reply == "" or lost?(reply, Agent.get(cut, & &1)), do: nil, else: reply
      end)

    {line |> Line.run(7 * @second) |> Line.handle({:client, 1, :up}), change, state,
     &Agent.update(cut, fn _ -> &1 end)}
  end

  defp lost?(_reply, nil), do: false
  defp lost?(_reply, :all), do: true

  defp lost?(reply, :status),
    do: match?({[%{id: id}], _} when id in [150, 0x2000], Parser.push(Parser.new(), reply))

  defp mavlink(line, message),
    do: Line.handle(line, {:mavlink, MavCodec.encode(message, system: 237, component: 191)})

  defp long(command, params),
    do:
      struct!(
        %M.CommandLong{target_system: 42, target_component: 1, command: command},
        for({value, n} <- Enum.with_index(params, 1), do: {:"param#{n}", value / 1})
      )

  # By each way that writes something.
  defp attempts(line, firmware) do
    name = %{betaflight: "small_angle", inav: "nav_rth_altitude"}[firmware]

    line
    |> mavlink(%M.ParamSet{
      target_system: 42,
      target_component: 1,
      param_id: name,
      param_value: 47.0,
      param_type: 9
    })
    |> mavlink(long(245, [1]))
    |> mavlink(long(241, [0, 1]))
    |> mavlink(long(209, [1, 0, 20, 1]))
    |> mavlink(%M.MissionCount{target_system: 42, target_component: 1, count: 1})
    |> Line.handle({:client, 1, Frame.encode(%Frame{id: 65, payload: <<1, 0, 2, 3>>})})
    |> Line.handle({:client, 1, Frame.encode(%Frame{id: 65, payload: <<1, 0, 2, 3, 4, 5, 6, 7>>})})
  end

  # What was written since that is not for armed vehicles.
  defp unfit(line, before, firmware) do
    for {at, bytes} <- line.written,
        at > before,
        {[frame], _} = Parser.push(Parser.new(), bytes),
        {:ok, message} = Messages.fetch(firmware, frame.id),
        Armed.only_disarmed?(message, frame),
        do: message.name
  end

  for firmware <- [:betaflight, :inav] do
    test "#{firmware}: after each cut of a second and a half nothing is set before it has said that it is disarmed" do
      {line, change, state, cut} = up(unquote(firmware))
      change.(&Firmware.sticks(&1, @armed))
      line = Line.run(line, @second)
      assert state.().armed
      before = line.now

      line =
        Enum.reduce(1..8, line, fn _n, line ->
          cut.(:all)
          line = Line.run(line, 1_500_000)
          cut.(nil)
          # As a program that tries thirty times a second.
          Enum.reduce(1..60, line, fn _n, line ->
            line |> mavlink(long(246, [1])) |> attempts(unquote(firmware)) |> Line.run(33_000)
          end)
        end)

      assert unfit(line, before, unquote(firmware)) == []
      assert state.().armed and state.().boots == 1
      assert Enum.any?(Line.told(line, M.ParamError))
    end

    test "#{firmware}: what was asked for before it was armed is not written after that" do
      {line, change, state, _cut} = up(unquote(firmware))
      line = Enum.reduce(1..4, line, fn _n, line -> attempts(line, unquote(firmware)) end)
      change.(&%{Firmware.sticks(&1, @armed) | armed: true})
      # What is under way is one request; then it says that it is armed.
      line = Line.run(line, 500_000)
      before = line.now
      line = Line.run(line, 5 * @second)
      assert state.().armed and unfit(line, before, unquote(firmware)) == []
    end

    test "#{firmware}: disarmed, the same is done once it has said so again" do
      {line, _change, state, cut} = up(unquote(firmware))
      map = %{betaflight: <<1, 0, 2, 3, 4, 5, 6, 7>>, inav: <<1, 0, 2, 3>>}[unquote(firmware)]
      cut.(:status)
      line = Line.run(line, 1_500_000)
      assert Armed.state(line.session) == :unknown
      cut.(nil)

      line =
        line |> Line.handle({:client, 1, Frame.encode(%Frame{id: 65, payload: map})}) |> Line.run(2 * @second)

      assert binary_part(state.().blocks[64], 0, 4) == <<1, 0, 2, 3>>
      assert line.failed == nil
    end
  end

  test "a vehicle whose flags have no known meaning is unknown, and says nothing of being disarmed" do
    armed = Controller.status(%{mode_flags: 1})

    line =
      Line.open(Controller.betaflight(%{"BOXIDS" => :refused, "STATUS_EX" => armed})) |> Line.run(4 * @second)

    assert Armed.state(line.session) == :unknown
    assert Line.told(line, M.Heartbeat) == []
    line = line |> mavlink(long(246, [1])) |> mavlink(long(245, [1])) |> Line.run(2 * @second)
    assert unfit(line, 0, :betaflight) == []
    assert Enum.uniq(for({_at, ack} <- Line.told(line, M.CommandAck), do: ack.result)) == [2]
    text = Enum.join(for({_at, text} <- Line.told(line, M.Statustext), do: text.text))
    assert text =~ "whether it is armed is not known"
  end

  test "a state that is older than a second is unknown" do
    line = Line.open(Controller.betaflight()) |> Line.run(4 * @second)
    assert Armed.state(line.session) == :disarmed
    assert Armed.state(%{line.session | now: line.session.now + 2 * @second}) == :unknown
    assert Armed.refusal(%{line.session | now: line.session.now + 2 * @second}) =~ "not known"
  end
end
