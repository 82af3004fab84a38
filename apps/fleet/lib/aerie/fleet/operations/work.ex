defmodule Aerie.Fleet.Operations.Work do
  @moduledoc """
  What an operation does to one vehicle, in a task of its own: a command, a change of its desired state, or a sequence
  of both. All is done in the name of the operation's author, and policy, rates and permissions hold for each vehicle
  by itself.
  """

  alias Aerie.Base.{Names, PubSub}
  alias Aerie.Control.{Commands, Missions}
  alias Aerie.Fleet.Remote.Merge
  alias Aerie.Fleet.Shadow
  alias Aerie.Vehicle.Command.Result
  alias Aerie.Fleet.Operations.{Core, Request, Sequence}
  alias Aerie.Fleet.Operations.Sequence.{GivingWay, Wait}
  alias Aerie.Control.Policy.Roles

  @look_ms 500
  # A vehicle that another gateway hears gives no notice.
  @unnoticed_ms 2_000

  @typedoc "What the work needs of an operation, beside the vehicle; `:step` is called with each step as it begins."
  @type job :: %{
          gateway: Names.gateway(),
          request: Request.t(),
          vehicles: [String.t(), ...],
          source: Roles.source(),
          via: String.t(),
          way: GivingWay.t(),
          step: (word :: String.t() -> term())
        }

  @doc "Does it, and gives what became of it."
  @spec run(job(), vehicle :: String.t()) :: Core.result()
  def run(%{request: %{what: {:sequence, all}}} = job, vehicle) do
    own = Enum.find(all, &(&1.vehicle == vehicle))
    result = steps(job, vehicle, Sequence.guarded(own.steps), 0)

    # What stands in for the steps makes up for them.
    if result.verdict == :failed and own.else != [] do
      instead = steps(job, vehicle, own.else, length(own.steps) + 1)
      words = for %{reason: reason} when reason != nil <- [result, instead], do: reason
      %{instead | reason: words |> Enum.uniq() |> Enum.join("; then: ")}
    else
      result
    end
  end

  def run(%{request: %{what: what}} = job, vehicle) do
    with nil <- if(GivingWay.moves?(what), do: given_way(job, vehicle)),
         do: step(job, vehicle, what, GivingWay.command_id(job.request.id, vehicle))
  end

  defp given_way(job, vehicle),
    do: with(<<why::binary>> <- GivingWay.reason(job.gateway, vehicle, job.way), do: failed(:rejected, why))

  defp steps(job, vehicle, steps, first) do
    steps
    |> Enum.with_index(first)
    |> Enum.reduce_while(nil, fn {step, i}, _last ->
      with nil <- given_way(job, vehicle) do
        job.step.(Sequence.word(step))
        result = step(job, vehicle, step, GivingWay.command_id(job.request.id, vehicle, i))
        if result.verdict == :ok, do: {:cont, result}, else: {:halt, named(result, step)}
      else
        given_up -> {:halt, given_up}
      end
    end)
  end

  defp named(result, {:command, type, _params}),
    do: %{result | reason: "#{type}: #{result.reason || result.status}"}

  defp named(result, _step), do: result

  defp step(%{request: request} = job, vehicle, {:command, type, params} = step, id) do
    envelope = %{
      "id" => id,
      "vehicle" => vehicle,
      "type" => type,
      "params" => params,
      "deadline" => (System.os_time(:millisecond) + timeout_ms(request, step)) / 1000
    }

    case Commands.submit(job.gateway, envelope, job.source, via: job.via) do
      {:ok, %{status: status} = result} when status in [:accepted, :completed] -> ok(status, result.reason)
      {:ok, %Result{status: status, reason: reason}} -> failed(status, reason)
      {:pending, _id} -> failed(:unknown, "it is under way for somebody else")
      {:error, errors} -> failed(:rejected, Enum.join(errors, "; "))
    end
  end

  defp step(%{gateway: gateway, request: request} = job, vehicle, {:shadow, update} = step, _id) do
    case with(
           nil <- lacking(gateway, vehicle, update),
           do: Shadow.update(gateway, vehicle, update, job.source, job.via)
         ) do
      {:ok, %{"version" => version}} when request.await == :written ->
        ok(:written, "version #{version}")

      {:ok, %{"version" => version}} ->
        converge(job, vehicle, {version, paths(update)}, now() + timeout_ms(request, step), "shadow")

      {:error, {kind, _why} = refusal} ->
        failed(kind, Shadow.text(refusal))
    end
  end

  defp step(job, vehicle, {:wait, wait}, _id),
    do: await(job, vehicle, Wait.begin(job.gateway, vehicle, wait), now() + wait.timeout_ms)

  # The desired state of one that is away may have it; one that is known to have no missions would try for minutes.
  defp lacking(gateway, vehicle, %{"desired" => %{"mission" => %{"plan" => <<_::binary>>}}}) do
    with %{} = snapshot <- Merge.vehicle(gateway, vehicle),
         <<why::binary>> <- Missions.gap(snapshot, :mission),
         do: {:error, {:refused, why}},
         else: (_may_have -> nil)
  end

  defp lacking(_gateway, _vehicle, _update), do: nil

  defp await(job, vehicle, wait, until),
    do: with(nil <- given_way(job, vehicle), do: look(job, vehicle, wait, until))

  defp look(job, vehicle, wait, until) do
    case Wait.look(job.gateway, vehicle, job.vehicles, wait) do
      :ok ->
        ok(:completed, nil)

      {:failed, why} ->
        failed(:rejected, why)

      {:waiting, why, for_whom} ->
        cond do
          now() < until ->
            changed(job.gateway, for_whom)
            await(job, vehicle, wait, until)

          wait.go_on? ->
            ok(:completed, why)

          true ->
            failed(:timeout, "#{why} after #{div(wait.timeout_ms, 1000)} s")
        end
    end
  end

  # Subscribed only while it waits: what a vehicle tells during a command is not kept.
  defp changed(gateway, vehicle) do
    topic = {:vehicle, vehicle}
    :ok = PubSub.subscribe(gateway, topic)
    noticed(topic, @unnoticed_ms)
    PubSub.unsubscribe(gateway, topic)
    noticed(topic, 0)
  end

  defp noticed(topic, ms) do
    receive do
      {:fleet, ^topic, _id} -> :ok
    after
      ms -> :ok
    end
  end

  defp timeout_ms(request, step), do: request.timeout_ms || Request.usual_ms(step)

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
  defp converge(job, vehicle, {version, paths} = wanted, until, said) do
    case standing(job.gateway, vehicle, version, paths) do
      :converged ->
        ok(:converged, nil)

      {:refused, path, why} ->
        failed(:refused, "#{path}: #{why}")

      {waiting, what} ->
        word = if waiting == :held, do: "shadow_held", else: "shadow"
        if word != said, do: job.step.(word)

        if now() >= until do
          failed(:timeout, "not converged before the deadline: #{what}")
        else
          Process.sleep(@look_ms)
          converge(job, vehicle, wanted, until, word)
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
      {nil, {path, %{"state" => "held"} = status}} -> {:held, "#{path} is held#{by(status)}"}
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
