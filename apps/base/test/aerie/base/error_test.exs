defmodule Aerie.Base.ErrorTest do
  use ExUnit.Case, async: true

  alias Aerie.Base.Error

  test "each reason is one line for a person; a hint follows it" do
    for {reason, message} <- [
          {{:unknown, :vehicle, "VID-9"}, "no vehicle VID-9 is known"},
          {{:unknown, :owner, "gcs"}, "there is no link and no client gcs"},
          {{:unknown, :link, "usb"}, "there is no link usb"},
          {{:exists, :client, "gcs"}, "there is already a client gcs"},
          {{:conflict, "it is armed"}, "it is armed"}
        ] do
      assert {:error, %Error{} = error} = Error.new(reason)
      assert Exception.message(error) == message
      assert {:error, error} = Error.new(reason, "land first")
      assert Exception.message(error) == message <> "; land first"
    end
  end
end
