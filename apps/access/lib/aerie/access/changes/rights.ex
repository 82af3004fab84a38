defmodule Aerie.Access.Changes.Rights do
  @moduledoc """
  The least role for each change of the gateway, by whichever way it is asked for. Pure. A route of `/api` and a page's
  event name the change that they make.

  What decides who may command, who is heard, or what is known of it later is an admin's. What a vehicle is asked to do
  is an operator's here, and the policy's beyond that (`Aerie.Control.Policy`). Requests over NATS change nothing of the
  gateway.
  """

  alias Aerie.Control.Policy.Roles

  @roles %{
    admin: [
      :add_link,
      :remove_link,
      :restart_link,
      :add_client,
      :remove_client,
      :change_rules,
      :reset_rules,
      :record_link,
      :record_vehicle,
      :play_recording,
      :delete_recording,
      :sign_vehicle,
      :make_key,
      :revoke_key,
      :change_users,
      :change_map,
      :change_log,
      :reload_config,
      :reload_policy
    ],
    operator: [:command, :cancel_command, :save, :store_plan],
    viewer: [:issue_ticket]
  }
  @least for {role, changes} <- @roles, change <- changes, into: %{}, do: {change, role}

  @typedoc "What is changed; the audit log has the same name."
  @type change :: atom()

  @doc "Every change with its least role."
  @spec all() :: %{change() => Roles.role()}
  def all, do: @least

  @doc "The least role for a change; an admin's if it is not listed."
  @spec least(change()) :: Roles.role()
  def least(change), do: Map.get(@least, change, :admin)
end
