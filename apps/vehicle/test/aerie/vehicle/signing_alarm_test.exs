defmodule Aerie.Vehicle.SigningAlarmTest do
  use Aerie.VehicleCase, async: true
  import Aerie.SigningCase, except: [start_signing: 1, start_signing: 2]

  alias Aerie.Base.Store

  @moduletag :tmp_dir
  @moduletag :capture_log
  @then 1_800_000_000_000_000

  test "an alarm is an event of the vehicle whose frames are refused", c do
    gateway = start_signing(c.tmp_dir)
    {first, signer} = signed(signer(), 1)
    assert %{delivered: 1} = Aerie.Reader.deliver(gateway, source(), [frame(first, @then)])
    {second, _} = signed(signer, 1)
    assert %{delivered: 1} = Aerie.Reader.deliver(gateway, source(), [frame(second, @then + 1)])
    :ok = Aerie.Base.PubSub.subscribe(gateway, :events)
    eventually(fn -> Store.vehicle(gateway, {"main", 1}) end)
    assert Store.vehicle(gateway, {"main", 1}).signing.state == :verified

    # So many that a pause between any two leaves an alarm's twenty on one side.
    for n <- 1..40, do: Aerie.Reader.deliver(gateway, source(), [frame(heartbeat(1, seq: n), @then + n)])

    assert_receive {:fleet, :events, %{type: "signing.rejected", data: data}}
    assert %{"link" => "radio", "component" => 1, "reasons" => %{"unsigned" => 20}} = data
  end
end
