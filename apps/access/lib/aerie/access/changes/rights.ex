defmodule Aerie.Api.Rights do
  @moduledoc """
  The least role for each change, by whichever way it is asked for. Pure. Those of `/api` stand with their routes
  (`Aerie.Api.Rest.Routes`); here is what only the console offers. A page of the console names the change
  behind each event (`changes:` of `Aerie.Console`).

  What decides who may command, who is heard, or what is known of it later is an admin's. What a vehicle is asked to do is an
  operator's here, and the policy's beyond that (`Aerie.Control.Policy`). Requests over NATS change nothing of the gateway.

  A way to change something that has no row is an admin's.
  """

  alias Aerie.Control.Policy.Roles
  alias Aerie.Api.Rest.Routes

  @console [:restart_link, :make_key, :revoke_key, :change_users, :play_recording, :delete_recording]

  @typedoc "An action of `Aerie.Api.Rest.Routes`, or a change that only the console offers."
  @type change :: atom() | tuple()

  @doc "Every change with its least role."
  @spec all() :: %{change() => Roles.role()}
  def all do
    routes =
      for %{method: method, action: action, role: role} <- Routes.all(), method != "GET", do: {action, role}

    Map.new(routes ++ Enum.map(@console, &{&1, :admin}))
  end

  @doc "The least role for a change."
  @spec least(change()) :: Roles.role()
  def least(change), do: Map.get(all(), change, :admin)
end
