defmodule Aerie.Fleet.Shadow.Loop.Actuator do
  @moduledoc """
  Sets one desired field of a vehicle at a time: by `Aerie.Control.Commands`, under the policy like anybody else, with the
  source `shadow`. It has the permissions that the field needs, because the field's author had them.
  """

  alias Aerie.Base.{Names, Store}
  alias Aerie.Control.{Commands, Missions, Params}
  alias Aerie.Vehicle.Enrolment
  alias MavRouter.Recorder
  alias Aerie.Vehicle.Command.Result
  alias Aerie.Control.Policy.Roles
  alias Aerie.Fleet.Shadow.Document.Field
  alias Aerie.Fleet.Shadow.Loop.{Core, Plans}
  alias Aerie.Vehicle.Services.Streams
  alias MavCodec.Dialects.All

  # An unanswered command is repeated until then, even if somebody takes over meanwhile.
  @command_s 3

  @type vehicle :: %{gateway: Names.gateway(), id: String.t(), key: Store.vehicle_key(), loop: pid()}

  @doc "Sets a field, and waits until the vehicle has answered."
  @spec set(vehicle(), Field.path(), value :: term()) :: Core.outcome()
  def set(vehicle, "mode" = path, mode), do: command(vehicle, {path, mode}, "set_mode", %{mode: mode})

  def set(vehicle, "armed" = path, armed?),
    do: command(vehicle, {path, armed?}, if(armed?, do: "arm", else: "disarm"), %{})

  def set(vehicle, "geofence.enabled" = path, on?),
    do: command(vehicle, {path, on?}, "set_geofence", %{enabled: on?})

  def set(vehicle, "home" = path, place), do: command(vehicle, {path, place}, "set_home", place)
  def set(vehicle, "params." <> name = path, value), do: param(vehicle, path, name, value)
  def set(vehicle, "intervals." <> name, hz), do: outcome(want(vehicle, name, hz))
  def set(vehicle, "recorder", true), do: outcome(Recorder.start(vehicle.gateway, {:vehicle, vehicle.key}))
  def set(vehicle, "recorder", false), do: outcome(Recorder.stop(vehicle.gateway, {:vehicle, vehicle.key}))
  def set(vehicle, "signing", true), do: outcome(Enrolment.enrol(vehicle.gateway, vehicle.id, by: "shadow"))
  def set(vehicle, "mission.plan" = path, hash), do: plan(vehicle, path, :mission, hash)
  def set(vehicle, "geofence.plan" = path, hash), do: plan(vehicle, path, :fence, hash)

  @doc "Withdraws an interval that is no longer desired."
  @spec withdraw(vehicle(), Field.path()) :: :ok
  def withdraw(vehicle, "intervals." <> name) do
    _ = want(vehicle, name, nil)
    :ok
  end

  # The demand ends with the loop; a new loop makes it again.
  defp want(vehicle, name, hz),
    do: Streams.want(vehicle.gateway, vehicle.key, {vehicle.loop, :shadow}, All.message_id(name), hz)

  # Read first: after a restart of the gateway their values are not known, and most are right.
  defp param(vehicle, path, name, value) do
    case Params.get(vehicle.gateway, vehicle.id, name) do
      {:ok, %{value: there} = param} ->
        if Field.equal?(path, value, there),
          do: :done,
          else:
            vehicle.gateway
            |> Params.set(vehicle.id, name, value, [type: param.type] ++ by({path, value}))
            |> answer()

      {:error, result} ->
        {:refused, reason(result)}
    end
  end

  # Read first, for the same reason.
  defp plan(vehicle, path, kind, hash) do
    with {:ok, plan} <- Plans.fetch(vehicle.gateway, hash),
         {:ok, {:differs, _seq, _how}} <- Missions.verify(vehicle.gateway, vehicle.id, kind, plan) do
      vehicle.gateway |> Missions.upload(vehicle.id, kind, plan, by({path, hash})) |> answer()
    else
      {:ok, :same} -> :done
      {:error, %Result{} = result} -> {:refused, reason(result)}
      {:error, why} -> {:refused, why}
    end
  end

  defp command(vehicle, field, type, params) do
    deadline = System.os_time(:millisecond) / 1000 + @command_s

    vehicle.gateway
    |> Commands.submit([vehicle: vehicle.id, type: type, params: params, deadline: deadline] ++ by(field))
    |> answer()
  end

  defp by({path, value}) do
    source = Roles.principal(:gateway, "shadow", :operator, Field.permissions(path, value))
    [as: source, via: "shadow"]
  end

  defp answer({:ok, %{status: status}}) when status in [:completed, :accepted], do: :done
  defp answer({:ok, result}), do: {:refused, reason(result)}
  defp answer({:pending, id}), do: {:refused, "the command #{id} is still under way"}
  defp answer({:error, errors}), do: {:refused, Enum.join(errors, "; ")}

  defp reason(result), do: result.reason || Atom.to_string(result.status)

  defp outcome(:ok), do: :done
  defp outcome({:ok, _more}), do: :done
  defp outcome({:error, :too_many}), do: {:refused, "too many message rates are wanted of this vehicle"}
  defp outcome({:error, error}), do: {:refused, Exception.message(error)}
end
