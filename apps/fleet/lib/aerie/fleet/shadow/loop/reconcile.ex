defmodule Aerie.Fleet.Shadow.Loop.Reconcile do
  @moduledoc """
  Compares the desired with the actual state of a vehicle, and decides what to do next. Pure.

      {actions, report} = Aerie.Fleet.Shadow.Loop.Reconcile.reconcile(desired, actual, context)

  At most one action changes the vehicle at a time, and only while nobody else is in charge. Stages follow each
  other: parameters, then fence and home, then the mission, then the mode, then arming. The report gives the state of each
  field:

    * `:converged` - as desired
    * `:pending` - in progress: being set, to be tried again later, or waiting for a field of an earlier stage
    * `:held` - not touched, because somebody else is in charge, or because it could move the vehicle off the ground
    * `:refused` - not possible, and no longer tried

  No action takes a vehicle off the ground: while it is armed and not known to fly, only modes that hold it or bring it
  down are set.
  """

  alias Aerie.Control.Policy.Intent
  alias Aerie.Fleet.Shadow.Document
  alias Aerie.Fleet.Shadow.Document.Field
  alias Aerie.Fleet.Shadow.Loop.{Attempts, Holds}

  @typedoc """
    * `:fields` - the vehicle's values by path; nil or missing: not known
    * `:mode`, `:armed`, `:in_air` - nil: not known
  """
  @type actual :: %{
          fields: %{Field.path() => term()},
          mode: String.t() | nil,
          armed: boolean() | nil,
          in_air: boolean() | nil
        }

  @typedoc """
    * `:holds` - what holds the shadow off (`Aerie.Fleet.Shadow.Loop.Holds.active/2`, and what the gateway adds)
    * `:busy` - the fields that are being set
    * `:allow_arming` - whether the field `armed` may be set
  """
  @type context :: %{
          now: integer(),
          holds: [Holds.hold()],
          attempts: Attempts.t(),
          busy: [Field.path()],
          allow_arming: boolean()
        }

  @typedoc "Set the field, which has this version, to the value."
  @type action :: {:set, Field.path(), version :: pos_integer(), value :: term()}
  @type status :: %{
          required(:state) => :converged | :pending | :held | :refused,
          optional(:why) => String.t(),
          optional(:by) => String.t(),
          optional(:until) => integer() | nil
        }
  @type report :: %{Field.path() => status()}

  # Besides the modes that hold a vehicle or bring it down: those in which a vehicle on the ground waits for its pilot.
  @waits_for_pilot ~w(STABILIZE STABILIZED ACRO MANUAL ALT_HOLD ALTCTL POSCTL FBWA FBWB TRAINING)
  @mission_modes ~w(AUTO AUTO_MISSION AUTO_RTL)

  @doc "The next actions, and the state of each field."
  @spec reconcile(%{Field.path() => Document.entry()}, actual(), context()) :: {[action()], report()}
  def reconcile(desired, actual, context) do
    fields =
      desired
      |> Enum.map(fn {path, entry} -> {Field.fetch!(path), path, entry} end)
      |> Enum.sort_by(fn {field, path, _entry} -> {field.stage, path} end)

    {actions, report, _blocked} =
      Enum.reduce(fields, {[], %{}, nil}, fn {field, path, entry}, {actions, report, open} ->
        status = status(field, path, entry, actual, context, {open, actions})
        open = open || if(status.state != :converged and field.stage > 0, do: {field.stage, path})

        case status do
          %{state: :act} ->
            {[{:set, path, entry.version, entry.value} | actions],
             Map.put(report, path, %{state: :pending, why: "being set"}), open}

          status ->
            {actions, Map.put(report, path, status), open}
        end
      end)

    {Enum.reverse(actions), report}
  end

  # The first reason that applies. `open`: the first field of the first stage that differs.
  defp status(field, path, entry, actual, context, {open, actions}) do
    with :differs <- compare(path, entry.value, actual),
         :ok <- allowed(path, context),
         :ok <- tries(path, entry, context),
         :ok <- safe(path, entry.value, actual),
         :ok <- in_charge(field, context),
         :ok <- in_turn(field, path, open),
         :ok <- free(field, path, context, actions) do
      %{state: :act}
    end
  end

  defp compare(path, desired, actual) do
    if Field.equal?(path, desired, actual.fields[path]), do: %{state: :converged}, else: :differs
  end

  defp allowed("armed", %{allow_arming: false}),
    do: %{state: :refused, why: "shadow.allow_arming is false, so the shadow neither arms nor disarms"}

  defp allowed(_path, _context), do: :ok

  defp tries(path, entry, context) do
    case Attempts.may(context.attempts, path, entry.version, context.now) do
      :go -> :ok
      {:wait, until, nil} -> %{state: :pending, why: "waits for the vehicle to show it", until: until}
      {:wait, until, reason} -> %{state: :pending, why: "tried again later: " <> reason, until: until}
      {:end, why} -> %{state: :refused, why: why}
    end
  end

  # If its arming is not known, a vehicle on the ground may be armed.
  defp safe("mode", mode, %{armed: armed, in_air: in_air}) when armed != false and in_air != true do
    if ends_flight?(mode),
      do: :ok,
      else: held("ground", "it is armed and not known to fly: #{mode} could move it off the ground")
  end

  defp safe("armed", true, %{mode: mode}) do
    if mode != nil and (ends_flight?(mode) or String.upcase(mode) in @waits_for_pilot),
      do: :ok,
      else:
        held("ground", "armed in the mode #{mode || "that it has"}, it could move off the ground by itself")
  end

  defp safe("armed", false, %{in_air: in_air}) when in_air != false,
    do: held("air", "it flies, or it is not known whether it does")

  defp safe("mission.plan", _hash, %{armed: armed, mode: mode})
       when armed != false and mode in @mission_modes,
       do: held("mission", "it flies its mission")

  defp safe("signing", _on, %{armed: armed}) when armed != false,
    do: held("armed", "keys are given to a disarmed vehicle only")

  defp safe(_path, _value, _actual), do: :ok

  defp ends_flight?(mode), do: Intent.named("set_mode", mode: mode).ends_flight?
  defp held(by, why), do: %{state: :held, by: by, until: nil, why: why}

  # Fields that do not affect the vehicle's behaviour do not depend on who is in charge.
  defp in_charge(%{permission: :telemetry}, _context), do: :ok
  defp in_charge(_field, %{holds: []}), do: :ok
  defp in_charge(_field, %{holds: [hold | _shorter]}), do: Map.put(hold, :state, :held)

  defp in_turn(%{stage: stage}, _path, {open, other}) when stage > open and open > 0,
    do: %{state: :pending, why: "waits for #{other}"}

  defp in_turn(_field, _path, _open), do: :ok

  defp free(%{permission: :telemetry}, path, context, _actions),
    do: if(path in context.busy, do: %{state: :pending, why: "being set"}, else: :ok)

  defp free(_field, path, context, actions) do
    cond do
      path in context.busy ->
        %{state: :pending, why: "being set"}

      changes_vehicle?(context.busy) ->
        %{state: :pending, why: "waits for its turn"}

      changes_vehicle?(for {:set, other, _version, _value} <- actions, do: other) ->
        %{state: :pending, why: "waits for its turn"}

      true ->
        :ok
    end
  end

  defp changes_vehicle?(paths), do: Enum.any?(paths, &(Field.fetch!(&1).permission != :telemetry))
end
