defmodule Aerie.Remote do
  @moduledoc """
  Vehicles of other gateways: their state comes by `Aerie.Remote.Listener`, commands go to them by this module, as NATS requests on
  `fleet.{environment}.{vehicle}.cmd.{type}`.

  The other gateway identifies this one by the signature (`remote.nkey_seed_file`) and decides by its own policy. The id stays, so
  its ledger keeps the command from being done twice. Nothing is queued: if nobody listens, or the vehicle is lost, the answer is
  `failed` with the rule `unreachable` at once, and nothing was sent.
  """
  @behaviour Aerie.Commands.Elsewhere

  alias Aerie.{Bridge, Command, Fleet, Names}
  alias Aerie.Command.Result
  alias Aerie.Policy.Signature

  # A command may go on after its deadline, which is when it is sent at the latest.
  @after_deadline_ms 300_000
  @cancel_ms 5_000
  @look_ms 500
  @max_text 512

  @impl Aerie.Commands.Elsewhere
  def submit(_gateway, %{status: :lost} = snapshot, command, _request, _progress),
    do: unreachable(command, "nothing was heard of it by NATS for a while; its gateway was #{snapshot.via}")

  def submit(gateway, snapshot, command, request, progress) do
    case Bridge.connection(gateway) do
      nil -> unreachable(command, "NATS is away, and the vehicle is heard by the gateway #{snapshot.via}")
      conn -> ask(gateway, conn, snapshot, command, request, progress)
    end
  catch
    :exit, _gone -> unknown(command, "the connection to NATS was lost while the command was under way")
  end

  defp ask(gateway, conn, snapshot, command, request, progress) do
    subject = "fleet.#{Bridge.environment(gateway)}.#{command.vehicle}.cmd.#{command.type}"
    body = body(command, request)
    timeout = div(command.deadline - System.os_time(:microsecond), 1000) + @after_deadline_ms
    options = [receive_timeout: max(timeout, 0), headers: signature(gateway, subject, body)]

    case Gnat.sub(conn, self(), "#{subject}.progress.#{command.id}") do
      {:ok, sid} ->
        task = Task.async(fn -> Gnat.request(conn, subject, body, options) end)

        try do
          wait(task, gateway, snapshot, command, progress)
        after
          _ = Task.shutdown(task, :brutal_kill)
          _ = Gnat.unsub(conn, sid)
        end

      {:error, _lost} ->
        unreachable(command, "the connection to NATS is lost")
    end
  end

  defp wait(%{ref: ref} = task, gateway, snapshot, command, progress) do
    receive do
      {:msg, %{body: text}} ->
        with {:ok, %{} = told} <- JSON.decode(text), do: progress.(Map.take(told, ["progress", "text"]))
        wait(task, gateway, snapshot, command, progress)

      {^ref, answer} ->
        result(answer, command, snapshot)

      {:DOWN, ^ref, :process, _pid, _reason} ->
        unknown(command, "the connection to NATS was lost while the command was under way")
    after
      @look_ms ->
        case Fleet.Remote.vehicle(gateway, command.vehicle, System.os_time(:microsecond)) do
          %{status: status} when status != :lost ->
            wait(task, gateway, snapshot, command, progress)

          _cut ->
            unknown(command, "the gateway #{snapshot.via} fell silent while the command was under way")
        end
    end
  end

  defp body(command, %{source: source, via: via}) do
    command
    |> Command.plain()
    |> Map.put("source", String.slice("#{source.name} by #{via}", 0, 64))
    |> JSON.encode!()
  end

  defp signature(gateway, subject, body) do
    case Names.value(gateway, :remote_supervisor) do
      %{nkey: nkey} when nkey != nil ->
        [{"Aerie-Signature", Signature.sign(nkey, subject, body, DateTime.utc_now())}]

      _unsigned ->
        []
    end
  end

  defp result({:ok, %{body: text}}, command, snapshot) do
    with {:ok, %{"result" => word} = answer} when is_binary(word) <- JSON.decode(text),
         {:ok, status} <- Result.status(word) do
      details =
        for {key, value} <- answer,
            key not in ~w(id result reason),
            plain?(value),
            into: %{},
            do: {key, value}

      Result.new(command.id, status, reason(answer["reason"]), Map.put(details, "gateway", snapshot.via))
    else
      _other -> unknown(command, "the gateway #{snapshot.via} answered without a result")
    end
  end

  defp result({:error, :no_responders}, command, snapshot),
    do: unreachable(command, "no gateway listens for it; it was heard by #{snapshot.via}")

  defp result({:error, _timeout_or_lost}, command, snapshot),
    do: unknown(command, "the gateway #{snapshot.via} did not answer in time")

  defp reason(text) when is_binary(text), do: String.slice(text, 0, @max_text)
  defp reason(_none), do: nil

  defp plain?(value),
    do: is_number(value) or is_boolean(value) or (is_binary(value) and byte_size(value) <= @max_text)

  defp unreachable(command, why),
    do:
      Result.new(command.id, :failed, "the vehicle cannot be reached, nothing was sent: #{why}", %{
        "rule" => "unreachable"
      })

  defp unknown(command, why), do: Result.new(command.id, :unknown, why)

  @impl Aerie.Commands.Elsewhere
  def cancel(gateway, snapshot, id) do
    subject = "fleet.#{Bridge.environment(gateway)}.#{snapshot.id}.cmd.cancel"
    body = JSON.encode!(%{"id" => id})
    options = [receive_timeout: @cancel_ms, headers: signature(gateway, subject, body)]

    with conn when conn != nil <- Bridge.connection(gateway),
         {:ok, %{body: text}} <- Gnat.request(conn, subject, body, options),
         {:ok, %{"result" => "accepted"}} <- JSON.decode(text) do
      :ok
    else
      {:ok, %{"reason" => reason}} -> {:error, reason(reason) || "the gateway #{snapshot.via} refused it"}
      _none -> {:error, "the gateway #{snapshot.via} does not answer"}
    end
  catch
    :exit, _gone -> {:error, "the connection to NATS was lost"}
  end
end
