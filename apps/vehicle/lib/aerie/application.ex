defmodule Aerie.Application do
  @moduledoc false
  use Application

  @impl Application
  def start(_type, _args) do
    Supervisor.start_link([{Registry, keys: :unique, name: Aerie.Registry}], strategy: :one_for_one)
  end
end
