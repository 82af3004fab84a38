defmodule Aerie.Api.Rest.Operations.Gateway do
  @moduledoc """
  What can be asked of the gateway itself, each declared in one file (`Aerie.Control.Operations.Operation`). It is asked
  over REST only.
  """

  alias Aerie.Api.Rest.Operations.{AddClient, AddLink, ChangeLog, Record, SaveRecording, Sign}

  use Aerie.Control.Operations.Table, [AddLink, AddClient, ChangeLog, Record, SaveRecording, Sign]
end
