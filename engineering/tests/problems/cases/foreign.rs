//! AutomationML without FAM's roles.

use super::{AML, Case};

pub const CASES: &[Case] = &[
    (
        "foreign: no controller",
        &[
            (
                AML,
                "FAMRoleClassLib/MechatronicComponent",
                "FAMRoleClassLib/Gateway",
            ),
            (
                "own.aml",
                "FAMRoleClassLib/Controller",
                "FAMRoleClassLib/Gateway",
            ),
        ],
    ),
    (
        "foreign: no logic",
        &[
            (
                AML,
                "FAMRoleClassLib/MechatronicComponent",
                "FAMRoleClassLib/Gateway",
            ),
            (AML, "PLCopenXMLInterface\">", "COLLADAInterface\">"),
            (
                AML,
                "<Attribute Name=\"refURI\"><Value>a.xml#Off</Value></Attribute>",
                "",
            ),
            (
                AML,
                "FAMInterfaceClassLib/RecoveryAction",
                "FAMInterfaceClassLib/Input",
            ),
        ],
    ),
    (
        "foreign: no reference",
        &[
            (
                AML,
                "FAMRoleClassLib/MechatronicComponent",
                "FAMRoleClassLib/Gateway",
            ),
            (AML, "refURI\"><Value>a.xml#A<", "refURL\"><Value>a.xml#A<"),
        ],
    ),
    (
        "foreign: malformed reference",
        &[
            (
                AML,
                "FAMRoleClassLib/MechatronicComponent",
                "FAMRoleClassLib/Gateway",
            ),
            (AML, "a.xml#A<", "http://example.org/a.xml<"),
        ],
    ),
    (
        "foreign: logic outside",
        &[
            (
                AML,
                "FAMRoleClassLib/MechatronicComponent",
                "FAMRoleClassLib/Gateway",
            ),
            (AML, "a.xml#A<", "../a.xml#A<"),
        ],
    ),
    (
        "foreign: no such POU",
        &[
            (
                AML,
                "FAMRoleClassLib/MechatronicComponent",
                "FAMRoleClassLib/Gateway",
            ),
            (AML, "a.xml#A<", "a.xml#Aa<"),
        ],
    ),
    (
        "foreign: missing logic",
        &[
            (
                AML,
                "FAMRoleClassLib/MechatronicComponent",
                "FAMRoleClassLib/Gateway",
            ),
            (AML, "a.xml#A<", "b.xml<"),
        ],
    ),
    (
        "foreign: no program",
        &[
            (
                AML,
                "FAMRoleClassLib/MechatronicComponent",
                "FAMRoleClassLib/Gateway",
            ),
            ("a.xml", "pouType=\"program\"", "pouType=\"functionBlock\""),
        ],
    ),
    (
        "foreign: what is assumed",
        &[(
            AML,
            "FAMRoleClassLib/MechatronicComponent",
            "FAMRoleClassLib/Gateway",
        )],
    ),
];
