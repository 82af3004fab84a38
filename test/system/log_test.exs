defmodule Aerie.System.LogTest do
  @moduledoc "What the log of a whole gateway says of crashes and events, and what it never says."

  use Aerie.SystemCase, async: true

  alias Aerie.{EventLog, LogLines}
  alias Aerie.Base.{Names, Secret}

  @moduletag :tmp_dir
  @moduletag :capture_log
  # Long enough for a key, and nothing else has it.
  @sentinel "5entinel-5entinel-5entinel"

  # The line of this test's own gateway that matches.
  defp await_line(pattern) do
    receive do
      {:line, line} -> if line =~ pattern, do: line, else: await_line(pattern)
    after
      Aerie.Patience.ms() -> flunk("no line matches #{inspect(pattern)}")
    end
  end

  defp crash(gateway, kind, id) do
    pid = eventually(fn -> Names.whereis(gateway, kind, id) end, "#{kind} runs")
    # As a bug would end it: with a report, which an exit signal does not give.
    spawn(fn -> :sys.terminate(pid, {:crash_of_the_test, gateway}, :infinity) end)
  end

  test "the report of a crash is one line with the link's or the vehicle's id", %{tmp_dir: folder} do
    LogLines.collect()
    %{gateway: gateway} = start_gateway(folder, links: ["udpin:127.0.0.1:0"])
    sim = [link: "udpout:127.0.0.1:#{link_port(gateway, "link-1")}"]
    start_supervised!({SimVehicle, sim ++ fast_vehicle(:px4)})
    eventually(fn -> data(gateway, :mode)[:mode] end, "the vehicle is heard")
    name = inspect(gateway)

    crash(gateway, :link, "link-1")
    line = await_line(~r/crash_of_the_test.*#{Regex.escape(name)}/)
    assert line =~ ~r/\Atime=\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}Z level=error msg="GenServer/
    assert line =~ " link=link-1"
    assert [_line, ""] = String.split(line, "\n")

    crash(gateway, :session, {"main", 1})

    assert await_line(~r/GenServer.*crash_of_the_test.*#{Regex.escape(name)}.* vehicle=/) =~
             " vehicle=VID-001"
  end

  test "no process shows a secret of the configuration when it crashes, and no line has one", %{
    tmp_dir: folder
  } do
    LogLines.collect()
    keys = private_file(folder, "keys", "boss #{@sentinel}-file role=admin\n")

    %{gateway: gateway} =
      start_gateway(folder,
        links: ["udpin:127.0.0.1:0"],
        overrides: %{
          "api" => %{"key" => @sentinel, "keys_file" => keys},
          "nats" => %{"port" => 0, "token" => @sentinel, "store_dir" => Path.join(folder, "nats")}
        }
      )

    link_port(gateway, "link-1")
    workers = workers(Names.whereis(gateway, :gateway))
    assert length(workers) > 20

    for pid <- workers do
      # What a crash report is made of, as Erlang and as Elixir write it.
      status = try(do: :sys.get_status(pid), catch: (:exit, _gone -> :gone))
      # The status begins with the process's dictionary, which no report has.
      shown = IO.iodata_to_binary(:io_lib.format(~c"~p", [status])) <> inspect(status, limit: :infinity)
      refute shown =~ @sentinel, inspect(Process.info(pid, :registered_name))
    end

    assert inspect(Secret.new(@sentinel)) =~ "hidden"
    refute_line(@sentinel)
  end

  defp refute_line(text) do
    receive do
      {:line, line} ->
        refute line =~ text
        refute_line(text)
    after
      0 -> :ok
    end
  end

  # Those with this text that are here.
  defp lines(text) do
    receive do
      {:line, line} -> if line =~ text, do: [line | lines(text)], else: lines(text)
    after
      0 -> []
    end
  end

  defp workers(supervisor) do
    Enum.flat_map(Supervisor.which_children(supervisor), fn
      {_id, pid, :worker, _modules} when is_pid(pid) -> if genserver?(pid), do: [pid], else: []
      {_id, pid, :supervisor, _modules} when is_pid(pid) -> workers(pid)
      _none -> []
    end)
  catch
    # No supervisor in OTP's sense.
    :exit, _reason -> []
  end

  defp genserver?(pid) do
    match?({module, _, _} when module != :proc_lib, :proc_lib.initial_call(pid)) and
      match?({_, {:gen_server, _, _}}, Process.info(pid, :current_function))
  end

  test "every line of the event log is of an event that exists" do
    known = for {event, _module} <- Aerie.Fleet.Telemetry.events(), do: event
    assert for({event, _level} <- EventLog.events(), event not in known, do: event) == []
  end

  test "what happens is one line with its subject; a flood is one line in five seconds", %{tmp_dir: folder} do
    LogLines.collect()
    %{gateway: gateway} = start_gateway(folder)
    :ok = EventLog.attach(gateway)
    :ok = EventLog.attach(gateway)
    on_exit(fn -> EventLog.detach(gateway) end)
    metadata = %{gateway: gateway, link: "radio1", network: "main", reason: "it was unplugged"}
    :telemetry.execute([:aerie, :link, :down], %{}, metadata)

    line = await_line("it was unplugged")
    assert line =~ ~s(level=warning msg="link down" gateway=)
    assert line =~ ~s( link=radio1 network=main reason="it was unplugged")
    # A line is written by whoever executes the event, so another one would be here by now.
    refute_line("it was unplugged")

    # Of another gateway: not attached.
    :telemetry.execute([:aerie, :link, :down], %{}, %{metadata | gateway: make_ref()})

    begun = System.monotonic_time(:millisecond)

    for n <- 1..50 do
      :telemetry.execute([:aerie, :router, :vehicle_refused], %{}, %{
        gateway: gateway,
        network: "flooded",
        system: n,
        reason: :too_many
      })
    end

    assert await_line("network=flooded") =~ "system=1 reason=too_many"
    took = System.monotonic_time(:millisecond) - begun
    # No further one, unless the machine stood still for so long.
    assert length(lines("network=flooded")) <= div(took, 5_000)
  end
end
