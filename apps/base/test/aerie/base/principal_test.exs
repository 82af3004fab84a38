defmodule Aerie.Base.PrincipalTest do
  use ExUnit.Case, async: true

  alias Aerie.Base.Principal

  test "who may do what: everything, what is listed, and nothing that needs no permission anybody could have" do
    for {may, permission, expected} <- [
          {:all, :terminate, true},
          {:all, nil, false},
          {[:fly], :fly, true},
          {[:fly], :arm, false}
        ],
        do: assert(Principal.may?(%Principal{kind: :user, name: "olga", may: may}, permission) == expected)
  end
end
