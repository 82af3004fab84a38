defmodule Aerie.Api.Rest.Operations.Commands do
  @moduledoc "What can be asked for about the commands of a vehicle."

  alias Aerie.Api.Rest.Operations.Commands.{Cancel, Get, Give, List, Types}

  @doc "The modules of these operations."
  @spec modules() :: [module(), ...]
  def modules, do: [Give, Get, Cancel, List, Types]
end
