defmodule Aerie.Base.PubSubTest do
  use ExUnit.Case, async: true

  alias Aerie.Base.{Names, PubSub}

  setup do
    gateway = make_ref()
    start_supervised!({PubSub, gateway: gateway, tick_ms: 5})
    {:ok, gateway: gateway}
  end

  test "subscribers of a topic get what is published, until they unsubscribe", %{gateway: gateway} do
    PubSub.subscribe(gateway, :events)
    PubSub.publish(gateway, :events, 1)
    PubSub.publish(gateway, :leases, 2)
    PubSub.publish(make_ref(), :events, 3)
    assert_received {:fleet, :events, 1}
    PubSub.unsubscribe(gateway, :events)
    PubSub.publish(gateway, :events, 4)
    refute_received {:fleet, _topic, _payload}
  end

  test "changes of links come once a tick, by id", %{gateway: gateway} do
    PubSub.subscribe(gateway, :links)
    PubSub.subscribe(gateway, {:link, "a"})
    for _ <- 1..100, id <- ["a", "b"], do: PubSub.changed(gateway, {:link, id})
    assert_receive {:fleet, :links, ids}
    assert_receive {:fleet, {:link, "a"}, "a"}
    assert ids -- ["a", "b"] == []
  end

  test "a subscriber that ended costs nothing, and without the process a change is not an error", %{
    gateway: gateway
  } do
    test = self()

    {pid, monitor} =
      spawn_monitor(fn ->
        PubSub.subscribe(gateway, :events)
        send(test, :subscribed)
        receive(do: (:end -> :ok))
      end)

    assert_receive :subscribed
    send(pid, :end)
    assert_receive {:DOWN, ^monitor, :process, ^pid, _reason}
    assert PubSub.publish(gateway, :events, 1) == :ok
    stop_supervised!(PubSub)
    assert PubSub.changed(gateway, {:vehicle, "A"}) == :ok
  end

  test "it answers its watchdog, so a stuck one is noticed", %{gateway: gateway} do
    pid = Names.whereis(gateway, :pubsub)
    send(pid, {:watchdog, self(), :tag})
    assert_receive {:alive, :tag, ^pid}
  end
end
