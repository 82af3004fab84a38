defmodule TelemetryTest do
  use ExUnit.Case, async: true

  import ExUnit.CaptureLog

  # Each test has its own event names and handler ids, because the table is one for the whole node.
  setup context do
    {:ok, id: {context.module, context.test}, event: [:telemetry_test, context.test]}
  end

  def forward(name, measurements, metadata, pid), do: send(pid, {:event, name, measurements, metadata})
  def fail(_name, _measurements, _metadata, fun), do: fun.()

  defp attach(context, id \\ nil) do
    :telemetry.attach(id || context.id, context.event, &__MODULE__.forward/4, self())
  end

  describe "attach and execute" do
    test "a handler gets name, measurements, metadata and its configuration", context do
      %{event: event} = context
      assert :ok = attach(context)
      assert :ok = :telemetry.execute(event, %{bytes: 7}, %{from: :here})
      assert_received {:event, ^event, %{bytes: 7}, %{from: :here}}
    end

    test "an event without handlers is nothing", %{event: event} do
      assert :ok = :telemetry.execute(event, %{}, %{})
    end

    test "a name is matched whole, neither by prefix nor by extension", %{event: event} = context do
      attach(context)
      :telemetry.execute(event ++ [:more], %{}, %{})
      :telemetry.execute([hd(event)], %{}, %{})
      refute_received {:event, _, _, _}
    end

    test "all handlers of an event run", %{event: event} = context do
      attach(context, {context.id, 1})
      attach(context, {context.id, 2})
      :telemetry.execute(event, %{}, %{})
      assert_received {:event, ^event, _, _}
      assert_received {:event, ^event, _, _}
    end

    test "the handlers of a prefix are listed", %{event: event, id: id} = context do
      attach(context)
      assert [%{id: ^id, event_name: ^event}] = :telemetry.list_handlers(event)
      assert %{id: id, event_name: event} in :telemetry.list_handlers([hd(event)])
      assert [] = :telemetry.list_handlers(event ++ [:more])
    end

    test "an id is unique", context do
      assert :ok = attach(context)
      assert {:error, :already_exists} = attach(context)
    end

    test "ids that look like match variables are plain values", context do
      assert :ok = attach(context, {:_, context.id})
      assert :ok = attach(context, {:"$1", context.id})
      assert {:error, :not_found} = :telemetry.detach(:_)
      assert :ok = :telemetry.detach({:_, context.id})
      assert :ok = :telemetry.detach({:"$1", context.id})
    end
  end

  describe "attach_many and detach" do
    test "one handler for several events leaves them all at once", %{event: event, id: id} do
      [first, second] = events = [event ++ [:a], event ++ [:b]]
      assert :ok = :telemetry.attach_many(id, events ++ [first], &__MODULE__.forward/4, self())
      Enum.each(events, &:telemetry.execute(&1, %{}, %{}))
      assert_received {:event, ^first, _, _}
      assert_received {:event, ^second, _, _}
      refute_received {:event, _, _, _}

      assert :ok = :telemetry.detach(id)
      Enum.each(events, &:telemetry.execute(&1, %{}, %{}))
      refute_received {:event, _, _, _}
      assert {:error, :not_found} = :telemetry.detach(id)
    end
  end

  describe "a handler that fails" do
    for {kind, code} <- [
          error: quote(do: raise("no")),
          exit: quote(do: exit(:no)),
          throw: quote(do: throw(:no))
        ] do
      test "by #{kind} is detached and reported, and affects nothing else",
           %{event: event, id: id} = context do
        :telemetry.attach(id, event, &__MODULE__.fail/4, fn -> unquote(code) end)
        attach(context, {id, :other})

        log = capture_log(fn -> :telemetry.execute(event, %{}, %{}) end)
        assert log =~ "is detached" and log =~ "no"
        assert_received {:event, ^event, _, _}
        assert {:error, :not_found} = :telemetry.detach(id)
      end
    end
  end
end
