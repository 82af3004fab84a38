defmodule Aerie.Control.Policy.Rules.Rule do
  @moduledoc "A rule: a pure check of what a command asks for against what is known of its vehicle."

  alias Aerie.Control.Policy
  alias Aerie.Control.Policy.Intent
  alias Aerie.Control.Policy.Intent.Context
  alias Aerie.Vehicle.Command.Refusal

  @doc "What is not known and needed denies, and the text says what it is."
  @callback check(Policy.t(), Intent.t(), Context.t()) :: :ok | Refusal.denial()
end
