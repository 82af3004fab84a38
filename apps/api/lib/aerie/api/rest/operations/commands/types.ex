defmodule Aerie.Api.Rest.Operations.Commands.Types do
  @moduledoc "The table of commands: for forms, and for programs that want to know what can be commanded."
  use Aerie.Control.Operations.Operation

  alias Aerie.Base.Json.Object
  alias Aerie.Vehicle.Command

  @answer Object.fields([{:types, {:list, {:object, Command.type_fields()}}, nil, "all of them"}])

  @impl true
  def operation do
    %Operation{
      name: "command.types",
      meaning: "Lists the commands with their parameters.",
      transfer?: false,
      answer: @answer,
      routes: [get("/api/commands/types", "The commands with their parameters.")]
    }
  end

  @impl true
  def run(_input, _context), do: {:ok, Object.show(@answer, %{types: Command.types()})}
end
