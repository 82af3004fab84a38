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

    test "execute/2 has empty metadata", %{event: event} = context do
      attach(context)
      :telemetry.execute(event, %{a: 1})
      assert_received {:event, ^event, %{a: 1}, meta} when meta == %{}
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

    test "an id is unique", context do
      assert :ok = attach(context)
      assert {:error, :already_exists} = attach(context)
    end

    test "ids that look like match variables are plain values", context do
      assert :ok = attach(context, {:_, context.id})
      assert :ok = attach(context, {:"$1", context.id})
      assert {:error, :not_found} = :telemetry.detach(:_)
      assert :ok = :telemetry.detach({:_, context.id})
      assert [%{id: {:"$1", _}}] = :telemetry.list_handlers(context.event)
    end

    test "a number instead of measurements still works, with a warning", %{event: event} = context do
      attach(context)
      assert capture_log(fn -> :telemetry.execute(event, 5, %{}) end) =~ "give a map of measurements"
      assert_received {:event, ^event, %{value: 5}, _}
    end

    test "a local function is attached, and reported", %{event: event} = context do
      log = capture_log(fn -> :telemetry.attach(context.id, event, fn _, _, _, _ -> :ok end, nil) end)
      assert log =~ "local function"
    end

    test "a wrong name or function is refused", context do
      capture = &__MODULE__.forward/4

      assert_raise ArgumentError, ~r/list of atoms/, fn ->
        :telemetry.attach(context.id, ["a"], capture, nil)
      end

      assert_raise ArgumentError, ~r/not be empty/, fn -> :telemetry.attach(context.id, [], capture, nil) end

      assert_raise ArgumentError, ~r/must be a list/, fn ->
        :telemetry.attach_many(context.id, :a, capture, nil)
      end

      assert_raise ArgumentError, ~r/four arguments/, fn -> :telemetry.attach(context.id, [:a], & &1, nil) end
      assert_raise ArgumentError, ~r/list of atoms/, fn -> :telemetry.list_handlers(["a"]) end
    end

    test "what is refused is badarg, as Erlang code expects it", context do
      capture = &__MODULE__.forward/4

      for fun <- [
            fn -> :telemetry.attach(context.id, ["a"], capture, nil) end,
            fn -> :telemetry.attach(context.id, [], capture, nil) end,
            fn -> :telemetry.attach_many(context.id, [[:a], [1]], capture, nil) end,
            fn -> :telemetry.attach(context.id, [:a], & &1, nil) end,
            fn -> :telemetry.list_handlers(["a"]) end
          ] do
        assert {:error, :badarg} = {:error, reason_of(fun)}
      end
    end

    # As Erlang sees it: `rescue` would make an exception of it.
    defp reason_of(fun) do
      fun.()
    catch
      :error, reason -> reason
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

    test "list_handlers finds by prefix", %{event: event, id: id} do
      :telemetry.attach_many(id, [event ++ [:a], event ++ [:b]], &__MODULE__.forward/4, :config)
      assert length(:telemetry.list_handlers(event)) == 2
      assert [%{id: ^id, config: :config, event_name: name}] = :telemetry.list_handlers(event ++ [:a])
      assert name == event ++ [:a]
      assert [] = :telemetry.list_handlers(event ++ [:c])
      assert Enum.any?(:telemetry.list_handlers([]), &(&1.id == id))
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
        :telemetry.attach({id, :failure}, [:telemetry, :handler, :failure], &__MODULE__.forward/4, self())
        :telemetry.attach(id, event, &__MODULE__.fail/4, fn -> unquote(code) end)
        attach(context, {id, :other})

        assert capture_log(fn -> :telemetry.execute(event, %{}, %{}) end) =~ "is detached"

        assert_received {:event, ^event, _, _}
        assert_received {:event, [:telemetry, :handler, :failure], times, %{handler_id: ^id} = failure}
        assert %{monotonic_time: _, system_time: _} = times
        assert %{event_name: ^event, kind: unquote(kind), reason: _, stacktrace: [_ | _]} = failure
        assert is_function(failure.handler_config, 0)
        assert {:error, :not_found} = :telemetry.detach(id)
        :telemetry.detach({id, :failure})
      end
    end
  end

  describe "span" do
    setup %{event: event, id: id} do
      events = for last <- [:start, :stop, :exception], do: event ++ [last]
      :telemetry.attach_many(id, events, &__MODULE__.forward/4, self())
      {:ok, start: Enum.at(events, 0), stop: Enum.at(events, 1), exception: Enum.at(events, 2)}
    end

    test "gives the result between start and stop", %{event: event, start: start, stop: stop} do
      assert :telemetry.span(event, %{a: 1}, fn -> {:result, %{b: 2}} end) == :result
      assert_received {:event, ^start, %{system_time: _, monotonic_time: began}, %{a: 1} = started}

      assert_received {:event, ^stop, %{duration: duration, monotonic_time: ended}, %{b: 2} = stopped}
      assert duration == ended - began
      assert started.telemetry_span_context == stopped.telemetry_span_context
      assert is_reference(started.telemetry_span_context)
      refute Map.has_key?(stopped, :a)
    end

    test "adds measurements, but not over its own", %{event: event, stop: stop} do
      :telemetry.span(event, %{}, fn -> {:ok, %{bytes: 3, duration: :mine}, %{}} end)
      assert_received {:event, ^stop, %{bytes: 3, duration: duration}, _} when is_integer(duration)
    end

    test "keeps a context it is given", %{event: event, start: start, stop: stop} do
      :telemetry.span(event, %{telemetry_span_context: 1}, fn -> {:ok, %{telemetry_span_context: 2}} end)
      assert_received {:event, ^start, _, %{telemetry_span_context: 1}}
      assert_received {:event, ^stop, _, %{telemetry_span_context: 2}}
    end

    test "reports an exception and raises it again", %{event: event, exception: exception} do
      assert_raise RuntimeError, "no", fn -> :telemetry.span(event, %{a: 1}, fn -> raise "no" end) end
      assert_received {:event, ^exception, %{duration: _, monotonic_time: _}, metadata}
      assert %{a: 1, kind: :error, reason: %RuntimeError{}, stacktrace: [_ | _]} = metadata
      assert is_reference(metadata.telemetry_span_context)
    end
  end
end
