defmodule Aerie.System.DrainTest do
  @moduledoc "SIGTERM with a command under way: it is drained within the grace time, or told as unknown."

  use Aerie.SystemCase, async: true

  import Aerie.BridgeCase, only: [other_vm: 2]

  @moduletag :tmp_dir
  @moduletag :capture_log
  @key "a-key-for-the-drain-test"

  setup do
    [http, udp] = [free_tcp_port(), free_udp_port()]

    sections = [
      links: [%{id: "radio", url: "udpin:127.0.0.1:#{udp}"}],
      http: %{port: http},
      api: %{key: @key},
      console: %{enabled: false},
      websocket: %{enabled: false},
      sockets: %{enabled: false},
      clients: [],
      nats: %{mode: :off},
      timeouts: patient()
    ]

    sim = start_supervised!({SimVehicle, firmware: :ardupilot, ready_s: 1.0, link: "udpout:127.0.0.1:#{udp}"})
    %{sections: sections, url: "http://127.0.0.1:#{http}/api/vehicles/VID-001/commands", sim: sim}
  end

  # A gateway as the program runs it, in a VM that ends by SIGTERM; with a command that the vehicle does not answer.
  defp commanded(context, grace_s) do
    config = config_file(context.tmp_dir, [commands: %{grace_s: grace_s}] ++ context.sections)

    script = """
    {:ok, _} = Application.ensure_all_started(:aerie)
    plan = %{config_file: #{inspect(config)}, overrides: %{}, sim: 0}
    {:ok, _run} = Aerie.CLI.Start.Run.start(plan, status: false)
    IO.puts("running " <> System.pid())
    Process.sleep(:infinity)
    """

    {port, pid} = other_vm(script, "running ")
    done = %{"type" => "set_mode", "params" => %{"mode" => "GUIDED"}}
    eventually(fn -> match?({200, _result}, post(context.url, done)) end, "it obeys")
    :ok = SimVehicle.fault(context.sim, :silence, true)
    mode = %{"type" => "set_mode", "params" => %{"mode" => "LOITER"}}
    task = Task.async(fn -> post(context.url, mode) end)
    SimVehicle.await(context.sim, &(&1.mode == "LOITER"))
    {_output, 0} = System.cmd("kill", ["-TERM", "#{pid}"])
    {port, task}
  end

  defp post(url, body) do
    # Otherwise a request waits behind the one that waits for its result.
    headers = [{~c"x-aerie-key", ~c"#{@key}"}, {~c"connection", ~c"close"}]
    request = {to_charlist(url), headers, ~c"application/json", JSON.encode!(body)}

    case :httpc.request(:post, request, [], body_format: :binary) do
      {:ok, {{_version, status, _reason}, _headers, reply}} -> {status, JSON.decode!(reply)}
      {:error, reason} -> reason
    end
  end

  defp await_end(port) do
    monitor = Port.monitor(port)
    assert_receive {:DOWN, ^monitor, :port, _port, _reason}
  end

  # A gateway that ends and whose command is still under way. The vehicle is asked for a few seconds only, and on a busy
  # machine those may be over before the gateway has seen its signal: then another one is asked to end.
  defp draining(context, tries \\ 5) do
    {port, task} = commanded(context, 120)

    refuses? = fn ->
      # It neither waits nor moves anything.
      probe = %{"type" => "request_message", "params" => %{"message_id" => 148}}

      case post(context.url <> "?wait=0", probe) do
        {503, %{"error" => %{"message" => text}}} -> text =~ "stopping"
        _other -> false
      end
    end

    case eventually(
           fn -> if refuses?.(), do: :drains, else: Task.yield(task, 0) end,
           "no new command is taken"
         ) do
      :drains ->
        {port, task}

      {:ok, {_status, %{"result" => "unknown"}}} when tries > 1 ->
        await_end(port)
        :ok = SimVehicle.fault(context.sim, :silence, false)
        draining(context, tries - 1)
    end
  end

  test "answered within the grace time: its result comes, and nothing new is taken", context do
    answered(context)
  end

  # On a busy machine the vehicle's time may be over before it is heard again.
  defp answered(context, tries \\ 5) do
    {port, task} = draining(context)
    :ok = SimVehicle.fault(context.sim, :silence, false)
    result = Task.await(task, :infinity)
    await_end(port)

    if match?({504, %{"result" => "unknown"}}, result) and tries > 1,
      do: answered(context, tries - 1),
      else: assert({200, %{"result" => "completed"}} = result)
  end

  test "not answered: told as unknown, and the program ends", context do
    assert unanswered(context) =~ "the gateway ended before"
  end

  # The reason that is told. As in `draining/2`, the vehicle's own time may be over before the gateway has seen its
  # signal.
  defp unanswered(context, tries \\ 5) do
    {port, task} = commanded(context, 0.5)
    assert {504, %{"result" => "unknown", "reason" => reason}} = Task.await(task, :infinity)
    await_end(port)

    if reason =~ "no acknowledgement came" and tries > 1 do
      :ok = SimVehicle.fault(context.sim, :silence, false)
      unanswered(context, tries - 1)
    else
      reason
    end
  end
end
