defmodule FleetWeb.Rights do
  @moduledoc """
  The least role for each change, by whichever way it is asked for. Pure. `/api` looks an action up here before it runs
  (`FleetWeb.API.Handler`), a page of the console names the change behind each event (`changes:` of `FleetWeb.Console`), and
  `docs/openapi.json` says it of each operation.

  What decides who may command, who is heard, or what is known of it later is an admin's. What a vehicle is asked to do is an
  operator's here, and the policy's beyond that (`Aerie.Control.Policy`). Requests over NATS change nothing of the gateway.

  A way to change something that has no row is an admin's.
  """

  alias Aerie.Control.Policy.Roles

  @admin [
    # Links, clients, rules, keys.
    :add_link,
    :remove_link,
    :restart_link,
    :add_client,
    :remove_client,
    :change_rules,
    :reset_rules,
    :sign_vehicle,
    :make_key,
    :revoke_key,
    :change_users,
    # What is in force, and what is written down.
    :reload_policy,
    :reload_config,
    :change_log,
    :record_vehicle,
    :record_link,
    :play_recording,
    :delete_recording
  ]

  @operator [
    :save,
    :command,
    :cancel_command,
    :update_shadow,
    :delete_shadow,
    :store_plan,
    :begin_operation,
    :stop_operation,
    {:transfer, :load_params},
    {:transfer, :set_param},
    {:transfer, {:put_plan, :mission}},
    {:transfer, {:put_plan, :fence}},
    {:transfer, {:put_plan, :rally}},
    {:transfer, {:clear_plan, :mission}},
    {:transfer, {:clear_plan, :fence}},
    {:transfer, {:clear_plan, :rally}},
    {:transfer, :write_file},
    {:transfer, :remove_file}
  ]

  # The WebSocket that a ticket opens may do no more than its key.
  @viewer [:issue_ticket]

  @rows for {role, changes} <- [admin: @admin, operator: @operator, viewer: @viewer],
            change <- changes,
            into: %{},
            do: {change, role}

  @rank Roles.all() |> Enum.with_index() |> Map.new()

  @typedoc "An action of `FleetWeb.API.Resources`, or a change that only the console offers."
  @type change :: atom() | tuple()

  @doc "Every change with its least role."
  @spec all() :: %{change() => Roles.role()}
  def all, do: @rows

  @doc "The least role for a change."
  @spec least(change()) :: Roles.role()
  def least(change), do: Map.get(@rows, change, :admin)

  @doc "The least role for an action of `/api`. Whoever is let in may read."
  @spec least(change(), method :: String.t()) :: Roles.role()
  def least(_action, method) when method in ["GET", "HEAD"], do: :viewer
  def least(action, _method), do: least(action)

  @doc "Whether a role may do what `least` may."
  @spec at_least?(Roles.role(), Roles.role()) :: boolean()
  def at_least?(role, least), do: Map.fetch!(@rank, role) >= Map.fetch!(@rank, least)
end
