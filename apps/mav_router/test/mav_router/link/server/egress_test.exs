defmodule MavRouter.Link.Server.EgressTest do
  use ExUnit.Case, async: true
  use Aerie.LinkCase

  alias MavRouter.Link.Server.Egress
  alias MavRouter.Link.Spec
  alias MavRouter.Router
  alias MavCodec.Messages

  setup do
    gateway = start_parts()
    spec = Spec.parse!("/dev/ttyS7,57600", id: "radio")
    egress = gateway |> Egress.open(spec) |> Egress.line({"/dev/ttyS7", 57_600}, 0)
    egress = Egress.sync(egress, %{:remote => "/dev/ttyS7"}, fn _ -> nil end, 0)
    {:ok, gateway: gateway, egress: egress}
  end

  # A line that accepts everything, or nothing; the state is what was written.
  defp takes(written, bytes), do: {:ok, [written, bytes]}
  defp full(written, _bytes), do: {:busy, written}

  defp forward(egress, class, frames, now, write \\ &takes/2),
    do: Egress.forward(egress, :remote, class, frames, now, write, [])

  test "a serial line gets no more than its rate, important frames first; drops are counted", c do
    frame = :binary.copy("b", 200)
    {egress, first} = forward(c.egress, :bulk, List.duplicate(frame, 2_000), 0)
    # A tenth of a second at once, the rest later; a timer is set for that.
    assert IO.iodata_length(first) in 576..800
    assert_receive {:pump, :remote}
    {egress, []} = forward(egress, :control, ["command"], 1)
    {_egress, next} = Egress.pump(egress, :remote, 500, &takes/2, [])
    assert "command" <> _bulk = IO.iodata_to_binary(next)
    assert [%{counters: %{dropped_bulk: dropped, dropped_control: 0}}] = Router.endpoints(c.gateway)
    assert dropped in 990..1_000
  end

  test "RADIO_STATUS slows it down", c do
    bytes = MavCodec.encode(%Messages.RadioStatus{txbuf: 5, rssi: 100}, system: 51, component: 68)
    {frames, _} = MavCodec.Parser.push_datagram(MavCodec.Parser.new(), bytes, 0)
    slow = Enum.reduce(1..20, c.egress, fn _, egress -> Egress.radio(egress, :remote, frames, 0) end)

    run = fn egress ->
      {egress, first} = forward(egress, :state, List.duplicate(:binary.copy("s", 100), 900), 0)

      {_egress, rest} =
        Enum.reduce(100..2_000//100, {egress, []}, fn now, {egress, sum} ->
          Egress.pump(egress, :remote, now, &takes/2, sum)
        end)

      IO.iodata_length([first, rest])
    end

    assert run.(c.egress) in 10_000..13_000
    assert run.(slow) < 2_500
  end

  test "frames that the line does not accept wait; a peer that is gone is not an error", c do
    {egress, []} = forward(c.egress, :state, ["one"], 0, &full/2)
    assert_receive {:pump, :remote}
    {egress, written} = Egress.pump(egress, :remote, 10, &takes/2, [])
    assert IO.iodata_to_binary(written) == "one"
    egress = Egress.remove(egress, :remote)
    assert {^egress, []} = forward(egress, :state, ["two"], 20)
    assert {^egress, []} = Egress.pump(egress, :remote, 20, &takes/2, [])
    assert Router.endpoints(c.gateway) == []
  end

  test "a USB port has no line rate", c do
    egress = Egress.line(c.egress, {"/dev/ttyACM0", 57_600}, 0)
    {_egress, written} = forward(egress, :bulk, List.duplicate(:binary.copy("b", 200), 500), 0)
    assert IO.iodata_length(written) == 100_000
  end
end
