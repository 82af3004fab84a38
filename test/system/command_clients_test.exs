defmodule Aerie.System.CommandClientsTest do
  @moduledoc "The clients of docs/clients, which sign commands over NATS, and the steps of docs/commands.md that lead to them."

  use Aerie.SystemCase, async: true
  use Aerie.PeerCase

  import Aerie.BridgeCase, only: [await_listening: 2]

  @moduletag :tmp_dir
  @moduletag :capture_log
  @root Path.expand("../..", __DIR__)
  @page File.read!(Path.join(@root, "docs/commands.md"))

  @tag :python
  test "in Python", context do
    python = Path.join(System.get_env("AERIE_VENV", Path.join(@root, ".venv")), "bin/python")
    try_client(context, [python, Path.join(@root, "docs/clients/command.py")])
  end

  @tag :go
  test("in Go", context, do: try_client(context, [Path.join(@root, ".go/command")]))

  defp try_client(%{tmp_dir: dir}, program) do
    [_all, file] = Regex.run(~r/bin\/aerie nats-key (\S+) > gateway\.yaml/, @page)
    assert {0, section} = Aerie.CLI.call(["nats-key", file], dir)
    config = Path.join(dir, "gateway.yaml")
    File.write!(config, section)
    seed = Path.join(dir, file)

    %{gateway: gateway} =
      start_gateway(dir,
        links: ["udpin:127.0.0.1:0"],
        config_file: config,
        overrides: %{"timeouts" => patient()}
      )

    link = "udpout:127.0.0.1:#{link_port(gateway, "link-1")}"
    sim = start_supervised!({SimVehicle, [link: link] ++ fast_vehicle(:ardupilot)})
    SimVehicle.await(sim, & &1.ready)
    await_listening(gateway, ["VID-001"])
    {:ok, url} = File.read(Path.join(dir, "nats/url"))
    command = fn subject, body -> run(program ++ [String.trim(url), seed, subject, body]) end

    # The page's own words, for the vehicle of this test.
    [_all, subject, body] = Regex.run(~r/ops\.nk fleet\.dev\.sim-001\.(\S+) '(.+)'/, @page)
    assert {0, output} = command.("fleet.test.VID-001." <> subject, body)
    assert %{"result" => "completed", "vehicle" => "VID-001"} = result(output)
    assert SimVehicle.state(sim).mode == "RTL"

    assert {1, output} = command.("fleet.test.VID-001.cmd.force_disarm", "{}")
    assert %{"result" => "denied", "rule" => "role"} = result(output)
    assert {1, output} = command.("fleet.test.NOBODY.cmd.hold", "{}")
    assert output =~ ~r/no ?responders/i

    # An invalid body gets an error about JSON, not a traceback of the program.
    for body <- ["{", "[1]", ""] do
      assert {1, output} = command.("fleet.test.VID-001.cmd.hold", body)
      assert output =~ "JSON" or output =~ "json"
      refute output =~ "Traceback"
    end

    # A transfer; the same id with other content is another one.
    assert {0, output} = command.("fleet.test.VID-001.params.get", ~s({"name": "RTL_ALT"}))
    assert %{"result" => "completed", "name" => "RTL_ALT"} = result(output)

    assert {0, _output} =
             command.("fleet.test.VID-001.cmd.set_mode", ~s({"id": "m1", "params": {"mode": "RTL"}}))

    assert {1, output} =
             command.("fleet.test.VID-001.cmd.set_mode", ~s({"id": "m1", "params": {"mode": "LOITER"}}))

    assert %{"id" => "m1", "rule" => "id"} = result(output)

    # A key that no section lists.
    other = Path.join(dir, "other.nk")
    File.write!(other, Nkey.seed(Nkey.generate(:user)))

    assert {1, output} =
             run(
               program ++
                 [
                   String.trim(url),
                   other,
                   "fleet.test.VID-001.cmd.set_mode",
                   ~s({"params": {"mode": "LOITER"}})
                 ]
             )

    assert %{"result" => "denied", "rule" => "signature"} = result(output)
    assert SimVehicle.state(sim).mode == "RTL"

    # Progress, and an end that leaves open what became of it; no simulated vehicle is as slow.
    answer = slow_gateway(gateway, "fleet.test.SLOW.cmd.calibrate")
    assert {1, output} = command.("fleet.test.SLOW.cmd.calibrate", "{}")
    assert output =~ ~r/^progress .*"turn it".*\nresult .*"timeout"/s
    Task.await(answer, Aerie.Patience.ms())
  end

  # Answers one request as a gateway does: progress, then the result.
  defp slow_gateway(gateway, subject) do
    test = self()

    task =
      Task.async(fn ->
        conn = nats_client(gateway)
        {:ok, _sid} = Gnat.sub(conn, self(), subject)
        # The server has read what was sent before this request.
        {:ok, _info} = Gnat.request(conn, "$JS.API.INFO", "", receive_timeout: Aerie.Patience.ms())
        send(test, :listening)
        assert_receive {:msg, %{body: body, reply_to: reply_to}}, Aerie.Patience.ms()
        %{"id" => id} = JSON.decode!(body)
        text = JSON.encode!(%{"id" => id, "progress" => 0.5, "text" => "turn it"})
        :ok = Gnat.pub(conn, "#{subject}.progress.#{id}", text)
        :ok = Gnat.pub(conn, reply_to, JSON.encode!(%{"id" => id, "result" => "timeout"}))
        {:ok, _info} = Gnat.request(conn, "$JS.API.INFO", "", receive_timeout: Aerie.Patience.ms())
      end)

    assert_receive :listening, Aerie.Patience.ms()
    task
  end

  defp result(output) do
    [_all, json] = Regex.run(~r/^result (.+)$/m, output)
    JSON.decode!(json)
  end

  defp run([program | words]) do
    {output, status} = System.cmd(program, words, stderr_to_stdout: true)
    {status, output}
  end
end
