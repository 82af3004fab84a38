defmodule Aerie.Fleet.Operations.Work do
  @moduledoc """
  What an operation does to one vehicle, in a task of its own: a command, or a change of its desired state. Either is
  done in the name of the operation's author, and policy, rates and permissions hold for each vehicle by itself.
  """

  alias Aerie.Base.Names
  alias Aerie.Control.Commands
  alias Aerie.Fleet.Shadow
  alias Aerie.Vehicle.Command.Result
  alias Aerie.Fleet.Operations.{Core, Request}
  alias Aerie.Control.Policy.Roles

  @look_ms 500

  @doc "Does it, and gives what became of it."
  @spec run(Names.gateway(), String.t(), Request.t(), Roles.source(), via :: String.t()) :: Core.result()
  def run(gateway, vehicle, %{what: {:command, type, params}} = request, source, via) do
    envelope = %{
      "id" => command_id(request.id, vehicle),
      "vehicle" => vehicle,
      "type" => type,
      "params" => params,
      "deadline" => (System.os_time(:millisecond) + request.timeout_ms) / 1000
    }

    case Commands.submit(gateway, envelope, source, via: via) do
      {:ok, %{status: status} = result} when status in [:accepted, :completed] -> ok(status, result.reason)
      {:ok, %Result{status: status, reason: reason}} -> failed(status, reason)
      {:pending, _id} -> failed(:unknown, "it is under way for somebody else")
      {:error, errors} -> failed(:rejected, Enum.join(errors, "; "))
    end
  end

  def run(gateway, vehicle, %{what: {:shadow, update}} = request, source, via) do
    case Shadow.update(gateway, vehicle, update, source, via) do
      {:ok, %{"version" => version}} when request.await == :written ->
        ok(:written, "version #{version}")

      {:ok, %{"version" => version}} ->
        converge(gateway, vehicle, {version, paths(update)}, now() + request.timeout_ms)

      {:error, {kind, _why} = refusal} ->
        failed(kind, Shadow.text(refusal))
    end
  end

  # The id of an operation's command for a vehicle: an operation that comes twice commands nobody twice.
  defp command_id(operation, vehicle) do
    <<short::binary-18, _rest::binary>> = :crypto.hash(:sha256, [operation, 0, vehicle])
    "op-" <> Base.url_encode64(short)
  end

  # Fields that were removed agree with anything.
  defp paths(%{"desired" => desired}) do
    for {name, value} <- desired,
        path <-
          if(is_map(value) and name != "home",
            do: for({child, v} <- value, v != nil, do: "#{name}.#{child}"),
            else: [name]
          ),
        value != nil,
        do: path
  end

  # The document may be another gateway's, so there is nobody who would tell.
  defp converge(gateway, vehicle, {version, paths} = wanted, until) do
    case standing(gateway, vehicle, version, paths) do
      :converged ->
        ok(:converged, nil)

      {:refused, path, why} ->
        failed(:refused, "#{path}: #{why}")

      {:waiting, what} ->
        if now() >= until do
          failed(:timeout, "not converged before the deadline: #{what}")
        else
          Process.sleep(@look_ms)
          converge(gateway, vehicle, wanted, until)
        end
    end
  end

  defp standing(gateway, vehicle, version, paths) do
    case Shadow.get(gateway, vehicle) do
      {:ok, %{"reported" => %{"desired_version" => seen, "fields" => fields}}} when seen >= version ->
        evaluate(Map.take(fields, paths))

      {:ok, %{"reported" => %{"gateway" => name}}} ->
        {:waiting, "the gateway #{name} has not looked at it yet"}

      {:ok, _nobody} ->
        {:waiting, "no gateway reports the vehicle"}

      {:error, refusal} ->
        {:waiting, Shadow.text(refusal)}
    end
  end

  defp evaluate(fields) do
    refused = Enum.find(fields, &match?({_path, %{"state" => "refused"}}, &1))
    open = Enum.find(fields, fn {_path, status} -> status["state"] != "converged" end)

    case {refused, open} do
      {{path, status}, _open} -> {:refused, path, status["why"]}
      {nil, {path, status}} -> {:waiting, "#{path} is #{status["state"]}#{by(status)}"}
      {nil, nil} -> :converged
    end
  end

  defp by(%{"by" => by, "why" => why}), do: " by #{by} (#{why})"
  defp by(%{"why" => why}), do: " (#{why})"
  defp by(_status), do: ""

  defp ok(status, reason), do: %{verdict: :ok, status: Atom.to_string(status), reason: reason}
  defp failed(status, reason), do: %{verdict: :failed, status: Atom.to_string(status), reason: reason}

  defp now, do: System.monotonic_time(:millisecond)
end
