defmodule Aerie.CLI.Bench.Restart do
  @moduledoc """
  Kills the whole gateway with `kill -9` in flight and starts it again as a user does. Measures how long it takes until
  state of its vehicle is in the store (which `/api` shows) and in NATS. Uses only public interfaces.
  """

  @root Path.expand("../../../..", __DIR__)
  @poll_ms 5

  @doc """
  One `%{http: ms, store: ms, nats: ms, position: ms}` per round, from the start of `bin/run`; `position` is the first
  position in NATS. The first round is a warm-up and is not counted.
  """
  @spec run(Path.t(), pos_integer) :: [map]
  def run(folder, rounds) do
    File.mkdir_p!(folder)
    {config, http, udp} = configure(folder)
    {:ok, _sim} = SimVehicle.start_link(firmware: :ardupilot, link: "udpout:127.0.0.1:#{udp}", ready_s: 1.0)
    url = Path.join(folder, "nats/url")
    [_first | counted] = for _round <- 0..rounds, do: round(config, http, url)
    counted
  end

  defp configure(folder) do
    [http, websocket] = for _n <- 1..2, do: free(&:gen_tcp.listen/2, &:gen_tcp.close/1)
    udp = free(&:gen_udp.open/2, &:gen_udp.close/1)
    config = Path.join(folder, "gateway.yaml")

    File.write!(config, """
    mavlink: {local_addr: off}
    links: [{id: radio, url: "udpin:127.0.0.1:#{udp}"}]
    http: {port: #{http}}
    websocket: {port: #{websocket}}
    sockets: {dir: "#{folder}"}
    nats: {port: 0, store_dir: "#{folder}/nats"}
    outbox: {dir: "#{folder}/outbox"}
    recorder: {dir: "#{folder}/recordings"}
    signing: {dir: "#{folder}/signing"}
    """)

    {config, http, udp}
  end

  defp free(open, close) do
    {:ok, socket} = open.(0, ip: {127, 0, 0, 1})
    {:ok, port} = :inet.port(socket)
    close.(socket)
    port
  end

  defp round(config, http, url) do
    File.rm(url)
    start = System.monotonic_time(:microsecond)

    port =
      Port.open({:spawn_executable, Path.join(@root, "bin/run")}, [
        :binary,
        :stderr_to_stdout,
        args: ["--config", config, "--quiet"],
        # As from a plain shell.
        env: for(name <- [~c"MIX_ENV", ~c"MIX_BUILD_PATH", ~c"AERIE_CODE"], do: {name, false})
      ])

    nats = Task.async(fn -> first_states(url, start) end)
    api(http, "/healthz")
    up = since(start)
    until(fn -> with %{"vehicles" => [%{"status" => "online"} | _]} <- api(http, "/api/status"), do: true end)
    times = Map.merge(%{http: up, store: since(start)}, Task.await(nats, :infinity))
    kill(port, config)
    times
  end

  # Kills the VM that runs with that configuration; its script then ends.
  defp kill(port, config) do
    {pids, 0} = System.cmd("pgrep", ["-f", "Application.*:aerie.*#{config}"])
    for pid <- String.split(pids), do: System.cmd("kill", ["-KILL", pid])
    ended(port)
  end

  defp ended(port) do
    receive do
      {^port, {:data, _output}} -> ended(port)
    after
      200 -> Port.info(port) != nil and ended(port)
    end
  end

  defp first_states(url, start) do
    %URI{host: host, port: port, userinfo: token} = until(fn -> address(url) end)

    nats =
      until(fn ->
        with {:ok, nats} <- Gnat.start_link(%{host: host, port: port, token: token}),
             do: nats,
             else: (_ -> nil)
      end)

    {:ok, _sid} = Gnat.sub(nats, self(), "fleet.*.*.state.*")
    any = await(fn _topic -> true end, start)
    position = await(&String.ends_with?(&1, ".position"), start)
    Gnat.stop(nats)
    %{nats: any, position: position}
  end

  # One message may be both.
  defp await(wanted?, start) do
    receive do
      {:msg, %{topic: topic} = message} ->
        if wanted?.(topic) do
          send(self(), {:msg, message})
          since(start)
        else
          await(wanted?, start)
        end
    end
  end

  defp address(url) do
    case File.read(url) do
      {:ok, "nats://" <> _ = text} -> URI.parse(String.trim(text))
      _not_yet -> nil
    end
  end

  defp api(port, path) do
    until(fn ->
      with {:ok, socket} <- :gen_tcp.connect({127, 0, 0, 1}, port, [:binary, active: false], 1_000),
           :ok <- :gen_tcp.send(socket, "GET #{path} HTTP/1.0\r\nhost: 127.0.0.1\r\n\r\n"),
           [_head, body] <- socket |> all("") |> String.split("\r\n\r\n", parts: 2) do
        case JSON.decode(body) do
          {:ok, object} -> object
          _text -> true
        end
      else
        _not_yet -> nil
      end
    end)
  end

  defp all(socket, got) do
    case :gen_tcp.recv(socket, 0, 2_000) do
      {:ok, bytes} -> all(socket, got <> bytes)
      {:error, _closed} -> got
    end
  end

  defp until(fun) do
    case fun.() do
      value when value in [nil, false] ->
        receive do
        after
          @poll_ms -> until(fun)
        end

      value ->
        value
    end
  end

  defp since(start), do: (System.monotonic_time(:microsecond) - start) / 1000
end
