defmodule Aerie.Fleet.Remote do
  @moduledoc """
  Vehicles of other gateways: their state comes by `Aerie.Fleet.Remote.Listener`, commands go to them by this module,
  as NATS requests on `fleet.{environment}.{vehicle}.cmd.{type}`.

  The other gateway identifies this one by the signature (`remote.nkey_seed_file`) and decides by its own policy. The
  id stays, so its ledger keeps the command from being done twice. Nothing is queued: if nobody listens, or the
  vehicle is lost, the answer is `failed` with the rule `unreachable` at once, and nothing was sent. Parameters and
  plans go the same way, on the subjects that `Aerie.Fleet.Bridge.Commands.Operation` answers.

  Before a command is sent anywhere, its id is claimed in the bucket `fleet_commands`, where all gateways of a NATS
  server see which of them sends it, and later what became of it.

  The lease of the shadow says which gateway holds a vehicle:

  | gateway | holds a vehicle |
  |---|---|
  | no NATS (`nats.mode: off`) | always |
  | a server of its own (`embedded`), also with a leaf node | unless another gateway that uses it has the lease |
  | `nats.url` | while its lease lasts; while NATS is away not, unless `shadow.without_nats` is `act` |
  """
  @behaviour Aerie.Control.Commands.Gateways

  alias Aerie.Base.Names
  alias Aerie.Fleet
  alias Aerie.Fleet.{Bridge, Nats}
  alias Aerie.Vehicle.Command
  alias Aerie.Fleet.Bridge.Commands.Operation
  alias Aerie.Vehicle.Command.{Refusal, Result}
  alias Aerie.Control.Policy.Roles.Signature
  alias Aerie.Fleet.Shadow.Documents
  alias Aerie.Fleet.Shadow.Store.Buckets

  # A command may go on after its deadline, which is when it is sent at the latest.
  @after_deadline_ms 300_000
  @cancel_ms 5_000
  @look_ms 500
  @max_text 512
  # The other gateway's answer may come a little after its time limit.
  @late_ms 5_000
  # A transfer without a time limit goes on as long as the other gateway reports progress.
  @idle_ms 600_000
  @longest_ms 86_400_000
  @own ~w(id result reason)
  @progress ~w(progress text phase done total)

  @impl Aerie.Control.Commands.Gateways
  defdelegate vehicle(gateway, id), to: Fleet

  @impl Aerie.Control.Commands.Gateways
  defdelegate holder(gateway, vehicle), to: Documents

  @impl Aerie.Control.Commands.Gateways
  def claim(gateway, vehicle, id, timeout_ms) do
    case Documents.nats(gateway) do
      {conn, environment} ->
        value = JSON.encode!(%{"by" => Documents.instance(gateway)})

        case Buckets.claim_command(conn, environment, {vehicle, id}, value, timeout_ms) do
          :ok -> :ok
          {:taken, text} -> taken(text, id, Documents.instance(gateway))
          error -> error
        end

      nil ->
        {:error, "NATS is away"}
    end
  end

  # Our own claim, of a command that our ledger has and knows as not sent.
  defp taken(text, id, me) do
    case JSON.decode(text) do
      {:ok, %{"by" => ^me} = claim} when not is_map_key(claim, "result") ->
        :ok

      {:ok, %{"by" => by} = claim} when is_binary(by) ->
        {:taken, %{by: by, result: claimed_result(claim, id)}}

      _other ->
        {:taken, %{by: "unnamed", result: nil}}
    end
  end

  defp claimed_result(%{"result" => word} = claim, id) when is_binary(word) do
    with {:ok, status} <- Result.status(word) do
      reason = if is_binary(claim["reason"]), do: claim["reason"]
      Result.new(id, status, reason, %{"gateway" => claim["by"]})
    else
      :error -> nil
    end
  end

  defp claimed_result(_claim, _id), do: nil

  @impl Aerie.Control.Commands.Gateways
  def done(gateway, vehicle, result) do
    _ =
      with {conn, environment} <- Documents.nats(gateway) do
        claim = %{
          "by" => Documents.instance(gateway),
          "result" => Atom.to_string(result.status),
          "reason" => result.reason && String.slice(result.reason, 0, 256)
        }

        Nats.pub(
          conn,
          Buckets.command_subject(environment, {vehicle, result.id}),
          JSON.encode_to_iodata!(claim)
        )
      end

    :ok
  end

  @impl Aerie.Control.Commands.Gateways
  def submit(gateway, snapshot, command, request, progress) do
    timeout = max(div(command.deadline - System.os_time(:microsecond), 1000) + @after_deadline_ms, 0)
    what = "cmd.#{command.type}"

    gateway
    |> ask(snapshot, command.id, what, body(command, request), timeout, progress)
    |> result(command.id, snapshot)
  end

  @impl Aerie.Control.Commands.Gateways
  def transfer(gateway, snapshot, id, {area, operation, body}, who, timeout_ms, progress) do
    limit = if timeout_ms, do: %{"timeout" => timeout_ms / 1000}, else: %{}
    text = body |> Map.merge(%{"id" => id, "source" => who}) |> Map.merge(limit) |> JSON.encode!()

    if byte_size(text) > Operation.max_bytes() do
      {:error, Result.new(id, :failed, Refusal.text(:request_large), %{"rule" => "size"})}
    else
      case ask(
             gateway,
             snapshot,
             id,
             "#{area}.#{operation}",
             text,
             timeout_ms && timeout_ms + @late_ms,
             progress
           ) do
        {:ok, %{"result" => "completed"} = answer} ->
          {:ok, answer |> Map.drop(@own) |> Map.put("gateway", snapshot.via)}

        other ->
          {:error, result(other, id, snapshot)}
      end
    end
  end

  # The other gateway's answer, or why there is none: nothing was sent, or nobody knows what became of it.
  defp ask(_gateway, %{status: :lost} = snapshot, _id, _what, _body, _timeout, _progress),
    do: Refusal.deny(:unheard_over_nats, via: snapshot.via)

  defp ask(gateway, snapshot, id, what, body, timeout, progress) do
    case Bridge.connection(gateway) do
      nil -> Refusal.deny(:nats_away, via: snapshot.via)
      conn -> ask(gateway, conn, snapshot, {id, what, body, timeout}, progress)
    end
  catch
    :exit, _gone -> Refusal.ended(:nats_lost_meanwhile)
  end

  defp ask(gateway, conn, snapshot, {id, what, body, timeout}, progress) do
    subject = "fleet.#{Bridge.environment(gateway)}.#{snapshot.id}.#{what}"
    options = [receive_timeout: timeout || @longest_ms, headers: signature(gateway, subject, body)]

    case Nats.sub(conn, self(), "#{subject}.progress.#{id}") do
      {:ok, sid} ->
        task = Task.async(fn -> Nats.request(conn, subject, body, options) end)

        try do
          wait(task, gateway, snapshot, progress, if(timeout == nil, do: now() + @idle_ms))
        after
          _ = Task.shutdown(task, :brutal_kill)
          _ = Nats.unsub(conn, sid)
        end

      {:error, _lost} ->
        Refusal.deny(:nats_lost)
    end
  end

  # `until`: when it is over without a word of progress; nil while the request itself has a time limit.
  defp wait(%{ref: ref} = task, gateway, snapshot, progress, until) do
    receive do
      {:msg, %{body: text}} ->
        with {:ok, %{} = told} <- JSON.decode(text), do: progress.(Map.take(told, @progress))
        wait(task, gateway, snapshot, progress, until && now() + @idle_ms)

      {^ref, answer} ->
        answer(answer, snapshot)

      {:DOWN, ^ref, :process, _pid, _reason} ->
        Refusal.ended(:nats_lost_meanwhile)
    after
      @look_ms ->
        cond do
          not there?(gateway, snapshot) ->
            Refusal.ended(:gateway_silent, via: snapshot.via)

          until != nil and now() >= until ->
            Refusal.ended(:no_progress, via: snapshot.via, minutes: div(@idle_ms, 60_000))

          true ->
            wait(task, gateway, snapshot, progress, until)
        end
    end
  end

  defp now, do: System.monotonic_time(:millisecond)

  # This gateway also hears the vehicle, and the other one holds it.
  defp there?(gateway, %{id: id, via: via, heard_here?: true}),
    do: match?({:other, ^via}, holder(gateway, id))

  defp there?(gateway, snapshot) do
    match?(
      %{status: status} when status != :lost,
      Fleet.Remote.Table.vehicle(gateway, snapshot.id, System.os_time(:microsecond))
    )
  end

  defp answer({:ok, %{body: text}}, snapshot) do
    case JSON.decode(text) do
      {:ok, %{"result" => word} = answer} when is_binary(word) -> {:ok, answer}
      _other -> Refusal.ended(:no_result, via: snapshot.via)
    end
  end

  defp answer({:error, :no_responders}, snapshot),
    do: Refusal.deny(:nobody_listens, via: snapshot.via)

  defp answer({:error, _timeout_or_lost}, snapshot),
    do: Refusal.ended(:no_answer_in_time, via: snapshot.via)

  defp body(command, %{source: source, via: via}) do
    command
    |> Command.plain()
    |> Map.put("source", Command.passed_on(source.name, via))
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

  defp result({:ok, %{"result" => word} = answer}, id, snapshot) do
    case Result.status(word) do
      {:ok, status} ->
        details = for {key, value} <- Map.drop(answer, @own), plain?(value), into: %{}, do: {key, value}
        Result.new(id, status, reason(answer["reason"]), Map.put(details, "gateway", snapshot.via))

      :error ->
        Refusal.result(id, Refusal.ended(:no_result, via: snapshot.via))
    end
  end

  defp result(refused_or_ended, id, _snapshot), do: Refusal.result(id, refused_or_ended)

  defp reason(text) when is_binary(text), do: String.slice(text, 0, @max_text)
  defp reason(_none), do: nil

  defp plain?(value),
    do: is_number(value) or is_boolean(value) or (is_binary(value) and byte_size(value) <= @max_text)

  @impl Aerie.Control.Commands.Gateways
  def cancel(gateway, snapshot, id) do
    subject = "fleet.#{Bridge.environment(gateway)}.#{snapshot.id}.cmd.cancel"
    body = JSON.encode!(%{"id" => id})
    options = [receive_timeout: @cancel_ms, headers: signature(gateway, subject, body)]

    with conn when conn != nil <- Bridge.connection(gateway),
         {:ok, %{body: text}} <- Nats.request(conn, subject, body, options),
         {:ok, %{"result" => "accepted"}} <- JSON.decode(text) do
      :ok
    else
      {:ok, %{"reason" => reason}} -> {:error, reason(reason) || "the gateway #{snapshot.via} refused it"}
      _none -> {:error, "the gateway #{snapshot.via} does not answer"}
    end
  end
end
